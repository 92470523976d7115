import numpy as np
import pinocchio as pin
import pytest
from sim_bridge.drives import (
    advance_drives,
    flexible_drives,
    FRICTION,
    friction_torque,
    joint_friction,
    RigidDrives,
    solve_joint_speed,
    solve_joint_speeds,
)

STEP, SUBSTEP, INERTIA = 1e-3, 2.5e-4, 0.784
ROW = np.array([(0.5, 27.0, 25.0, 1e-3)], dtype=FRICTION)[0]
NO_FRICTION = np.array([(0.0, 0.0, 0.0, 1e-3)] * 2, dtype=FRICTION)


def test_flexible_drives_conserve_energy_without_damping():
    """Two rotors on two free flywheels: no drift over 20 000 steps (symplectic Euler)."""
    inertia, wheel, stiffness = (
        np.array([0.8, 0.2]),
        np.array([0.3, 0.01]),
        np.array([3e4, 2e3]),
    )
    drives = flexible_drives(inertia, stiffness, np.zeros(2), NO_FRICTION)
    q, qd, torque = np.zeros(2), np.array([0.5, -0.5]), np.zeros(2)
    energy, momentum = [], []
    for _ in range(20000):
        advance_drives(np.zeros(2), q, qd, drives, SUBSTEP, torque)
        qd += SUBSTEP * torque / wheel
        q += SUBSTEP * qd
        twist = drives['q'] - q
        energy.append(
            0.5
            * np.sum(inertia * drives['qd'] ** 2 + wheel * qd**2 + stiffness * twist**2)
        )
        momentum.append(inertia * drives['qd'] + wheel * qd)
    assert np.mean(energy[-5000:]) == pytest.approx(np.mean(energy[:5000]), rel=1e-3)
    np.testing.assert_allclose(
        momentum, np.tile(wheel * [0.5, -0.5], (20000, 1)), atol=1e-9
    )


@pytest.mark.parametrize('scale', [0.0, 0.6])
def test_rigid_drives_make_bare_links_move_as_with_rotors_and_friction(
    puma, model, rng, scale
):
    bare, table = model.copy(), joint_friction(puma, scale, 1e-3)
    model.armature = np.array(puma.armature)
    drives, applied = RigidDrives(model, table, STEP), np.zeros(6)
    for _ in range(5):
        q, qd, torque, load = rng.uniform(-1, 1, (4, 6))
        drives.find_link_torque(torque, torque + load, q, qd, applied)
        speed = qd + STEP * pin.aba(bare, bare.createData(), q, qd, applied + load)
        friction = [
            friction_torque(v, row)[0] for v, row in zip(speed, table, strict=True)
        ]
        expected = qd + STEP * pin.aba(
            model, model.createData(), q, qd, torque + load - np.array(friction)
        )
        np.testing.assert_allclose(speed, expected, atol=1e-9)


def test_implicit_speeds_solve_their_equations(puma, model, rng):
    table = joint_friction(puma, 1.0, 1e-3)
    model.armature = np.array(puma.armature)
    for _ in range(50):
        inertia = pin.crba(model, model.createData(), rng.uniform(-1, 1, 6))
        free = rng.standard_normal(6) * 10 ** rng.uniform(-6, 0.5, 6)
        speed = np.zeros(6)
        solve_joint_speeds(free, STEP, inertia, table, speed)
        friction = [
            friction_torque(v, row)[0] for v, row in zip(speed, table, strict=True)
        ]
        residual = inertia @ (speed - free) + STEP * np.array(friction)
        np.testing.assert_allclose(residual, 0.0, atol=1e-10)
    for free in rng.choice([-1, 1], 500) * 10 ** rng.uniform(-9, 1, 500):
        speed = solve_joint_speed(free, SUBSTEP, INERTIA, ROW)
        residual = speed - free + SUBSTEP / INERTIA * friction_torque(speed, ROW)[0]
        assert residual == pytest.approx(0.0, abs=1e-9 * max(1e-3, abs(free)))
        assert min(0.0, free) <= speed <= max(0.0, free)
