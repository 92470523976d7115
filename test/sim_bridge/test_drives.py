import numpy as np
from numpy.testing import assert_allclose
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

STEP = 1e-3  # s
SUBSTEP = 2.5e-4  # s
INERTIA = 0.784  # kg m^2
ROW = np.array([(0.5, 27.0, 25.0, 1e-3)], dtype=FRICTION)[0]
NO_FRICTION = np.array([(0.0, 0.0, 0.0, 1e-3)] * 2, dtype=FRICTION)


def friction_torques(speed, table):
    """Return the friction of all joints at their speeds [N m]."""
    pairs = zip(speed, table, strict=True)
    return np.array([friction_torque(*pair)[0] for pair in pairs])


def test_flexible_drives_conserve_energy_without_damping():
    """Two rotors on two free flywheels: no drift over 20 000 steps (symplectic Euler)."""
    rotor = np.array([0.8, 0.2])
    wheel = np.array([0.3, 0.01])
    stiffness = np.array([3e4, 2e3])
    drives = flexible_drives(rotor, stiffness, np.zeros(2), NO_FRICTION)
    q = np.zeros(2)
    qd = np.array([0.5, -0.5])
    no_command = np.zeros(2)
    torque = np.zeros(2)
    energies = []
    momentum = wheel * qd
    for _ in range(20000):
        advance_drives(no_command, q, qd, drives, SUBSTEP, torque)
        qd += SUBSTEP * torque / wheel
        q += SUBSTEP * qd
        kinetic = rotor @ drives['qd'] ** 2 + wheel @ qd**2
        elastic = stiffness @ (drives['q'] - q) ** 2
        energies.append(0.5 * (kinetic + elastic))
        total = rotor * drives['qd'] + wheel * qd
        assert np.abs(total - momentum).max() < 1e-9
    first, last = energies[:5000], energies[-5000:]
    assert np.mean(last) == pytest.approx(np.mean(first), rel=1e-3)


@pytest.mark.parametrize('scale', [0.0, 0.6])
def test_rigid_drives_make_bare_links_move_as_with_rotors_and_friction(
    puma, model, rng, scale
):
    bare = model.copy()
    bare_data = bare.createData()
    model.armature = np.array(puma.armature)
    data = model.createData()
    table = joint_friction(puma, scale, 1e-3)
    drives = RigidDrives(model, table, STEP)
    applied = np.zeros(6)
    for _ in range(5):
        q, qd, torque, load = rng.uniform(-1, 1, (4, 6))
        drives.find_link_torque(torque, torque + load, q, qd, applied)
        speed = qd + STEP * pin.aba(bare, bare_data, q, qd, applied + load)
        net_torque = torque + load - friction_torques(speed, table)
        expected = qd + STEP * pin.aba(model, data, q, qd, net_torque)
        assert_allclose(speed, expected, atol=1e-9)


def test_implicit_speeds_of_all_joints_solve_their_equation(puma, model, rng):
    """M (v - v_free) + h F(v) = 0."""
    table = joint_friction(puma, 1.0, 1e-3)
    model.armature = np.array(puma.armature)
    data = model.createData()
    for _ in range(50):
        M = pin.crba(model, data, rng.uniform(-1, 1, 6))
        free = rng.standard_normal(6) * 10 ** rng.uniform(-6, 0.5, 6)
        speed = np.zeros(6)
        solve_joint_speeds(free, STEP, M, table, speed)
        residual = M @ (speed - free) + STEP * friction_torques(speed, table)
        assert_allclose(residual, 0.0, atol=1e-10)


def test_implicit_speed_of_one_joint_solves_its_equation_between_rest_and_free(rng):
    for free in rng.choice([-1, 1], 500) * 10 ** rng.uniform(-9, 1, 500):
        speed = solve_joint_speed(free, SUBSTEP, INERTIA, ROW)
        friction, _ = friction_torque(speed, ROW)
        residual = speed - free + SUBSTEP / INERTIA * friction
        assert residual == pytest.approx(0.0, abs=1e-9 * max(1e-3, abs(free)))
        assert min(0.0, free) <= speed <= max(0.0, free)
