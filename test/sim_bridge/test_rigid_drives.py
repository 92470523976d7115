import numpy as np
import pinocchio as pin
import pytest
from sim_bridge.joint_friction import friction_torque, joint_friction
from sim_bridge.rigid_drives import implicit_joint_speed, RigidDrives

STEP = 1e-3


@pytest.fixture
def arm_with_rotors(robot, model):
    model.armature = np.array(robot.exact_armature)
    return model


def test_rigid_drives_make_bare_links_accelerate_as_with_rotors(robot, arm_with_rotors, rng):
    model = arm_with_rotors
    drives = RigidDrives(model, joint_friction(robot, 0.0, 1e-3), STEP)
    bare = model.copy()
    bare.armature = np.zeros(6)
    for _ in range(5):
        q, qd, torque, load = rng.uniform(-1, 1, (4, 6))
        applied = np.empty(6)
        drives.torque(torque, load, q, qd, applied)
        found = pin.aba(bare, bare.createData(), q, qd, applied + load)
        expected = pin.aba(model, model.createData(), q, qd, torque + load)
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_implicit_joint_speed_solves_its_equation(robot, arm_with_rotors, rng):
    model, table = arm_with_rotors, joint_friction(robot, 1.0, 1e-3)
    for _ in range(50):
        upper = np.triu(pin.crba(model, model.createData(), rng.uniform(-1, 1, 6)))
        mass_matrix = upper + np.triu(upper, 1).T
        free = rng.standard_normal(6) * 10 ** rng.uniform(-6, 0.5, 6)
        speed = np.zeros(6)
        implicit_joint_speed(free, STEP, mass_matrix, table, speed)
        friction = [friction_torque(v, row) for v, row in zip(speed, table, strict=True)]
        residual = mass_matrix @ (speed - free) + STEP * np.array(friction)
        np.testing.assert_allclose(residual, 0.0, atol=1e-10)


def test_rigid_drives_with_friction_brake_like_the_implicit_solution(
        robot, arm_with_rotors, rng):
    model, table = arm_with_rotors, joint_friction(robot, 0.6, 1e-3)
    drives = RigidDrives(model, table, STEP)
    bare = model.copy()
    bare.armature = np.zeros(6)
    q, qd, torque = rng.uniform(-1, 1, (3, 6))
    applied = np.empty(6)
    drives.torque(torque, np.zeros(6), q, qd, applied)
    speed = qd + STEP * pin.aba(bare, bare.createData(), q, qd, applied)
    friction = [friction_torque(v, row) for v, row in zip(speed, table, strict=True)]
    expected = qd + STEP * pin.aba(
        model, model.createData(), q, qd, torque - np.array(friction))
    np.testing.assert_allclose(speed, expected, atol=1e-9)
