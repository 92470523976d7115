import numpy as np
import pinocchio as pin
import pytest
from sim_bridge.drives import (
    advance_drives,
    flexible_drives,
    FRICTION,
    friction_at,
    implicit_joint_speed,
    implicit_speed,
    joint_friction,
    RigidDrives,
)
from sim_bridge.kinematics import mass_matrix

STEP, SUBSTEP, INERTIA = 1e-3, 2.5e-4, 0.784
ROW = np.array([(0.5, 27.0, 25.0, 1e-3)], dtype=FRICTION)[0]
NO_FRICTION = np.array([(0.0, 0.0, 0.0, 1e-3)] * 2, dtype=FRICTION)


def test_flexible_drives_conserve_energy_without_damping():
    """Two rotors on two free flywheels: no drift over 20 000 steps (symplectic Euler)."""
    inertia, wheel, step = np.array([0.8, 0.2]), np.array([0.3, 0.01]), 2.5e-4
    stiffness = np.array([3e4, 2e3])
    drives = flexible_drives(inertia, stiffness, np.zeros(2), NO_FRICTION)
    q, qd, torque = np.zeros(2), np.array([0.5, -0.5]), np.zeros(2)
    energy, momentum = [], []
    for _ in range(20000):
        advance_drives(np.zeros(2), q, qd, drives, step, torque)
        qd += step * torque / wheel
        q += step * qd
        twist = drives['q'] - q
        energy.append(0.5 * np.sum(
            inertia * drives['qd'] ** 2 + wheel * qd ** 2 + stiffness * twist ** 2))
        momentum.append(inertia * drives['qd'] + wheel * qd)
    early, late = np.mean(energy[:5000]), np.mean(energy[-5000:])
    assert late == pytest.approx(early, rel=1e-3)
    np.testing.assert_allclose(momentum, np.tile(wheel * [0.5, -0.5], (20000, 1)), atol=1e-9)


def test_flexible_drives_rest_with_springs_wound_up():
    drives = flexible_drives(
        np.ones(2), np.array([1e4, 2e3]), np.array([10.0, 1.0]), NO_FRICTION)
    q, load, torque = np.array([0.3, -0.2]), np.array([30.0, -5.0]), np.zeros(2)
    drives['q'] = q + load / drives['stiffness']
    for _ in range(100):
        advance_drives(load, q, np.zeros(2), drives, SUBSTEP, torque)
    np.testing.assert_allclose(torque, load, rtol=1e-9)
    np.testing.assert_allclose(drives['qd'], 0.0, atol=1e-12)


@pytest.fixture
def arm_with_rotors(puma, model):
    model.armature = np.array(puma.armature)
    return model


@pytest.mark.parametrize('scale', [0.0, 0.6])
def test_rigid_drives_make_bare_links_move_as_with_rotors_and_friction(
        puma, arm_with_rotors, rng, scale):
    model, table = arm_with_rotors, joint_friction(puma, scale, 1e-3)
    drives, bare = RigidDrives(model, table, STEP), model.copy()
    bare.armature = np.zeros(6)
    applied = np.zeros(6)
    for _ in range(5):
        q, qd, torque, load = rng.uniform(-1, 1, (4, 6))
        drives.advance(torque, torque + load, q, qd, applied)
        speed = qd + STEP * pin.aba(bare, bare.createData(), q, qd, applied + load)
        friction = [friction_at(v, row)[0] for v, row in zip(speed, table, strict=True)]
        expected = qd + STEP * pin.aba(
            model, model.createData(), q, qd, torque + load - np.array(friction))
        np.testing.assert_allclose(speed, expected, atol=1e-9)


def test_implicit_joint_speed_solves_its_equation(puma, arm_with_rotors, rng):
    model, table = arm_with_rotors, joint_friction(puma, 1.0, 1e-3)
    for _ in range(50):
        inertia = mass_matrix(model, model.createData(), rng.uniform(-1, 1, 6))
        free = rng.standard_normal(6) * 10 ** rng.uniform(-6, 0.5, 6)
        speed = np.zeros(6)
        implicit_joint_speed(free, STEP, inertia, table, speed)
        friction = [friction_at(v, row)[0] for v, row in zip(speed, table, strict=True)]
        residual = inertia @ (speed - free) + STEP * np.array(friction)
        np.testing.assert_allclose(residual, 0.0, atol=1e-10)


def test_implicit_speed_solves_its_equation(rng):
    for _ in range(500):
        free = rng.choice([-1, 1]) * 10 ** rng.uniform(-9, 1)
        speed = implicit_speed(free, SUBSTEP, INERTIA, ROW)
        residual = speed - free + SUBSTEP / INERTIA * friction_at(speed, ROW)[0]
        assert residual == pytest.approx(0.0, abs=1e-9 * max(1e-3, abs(free)))
        assert min(0.0, free) <= speed <= max(0.0, free)
