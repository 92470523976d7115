import numpy as np
import pinocchio as pin
import pybullet as bullet
import pytest
from sim_bridge.bullet_arm import BulletArm
from sim_bridge.puma560 import puma_arm

GRAVITY = (0.0, 0.0, -9.81)
STEP = 5e-4
JOINTS = range(6)


@pytest.fixture
def arm(robot):
    arm = BulletArm(puma_arm(robot), GRAVITY, STEP)
    arm.reset(np.zeros(6))
    yield arm
    arm.close()


def set_state(arm, q, qd):
    arm.q[:], arm.qd[:] = q, qd
    for joint in JOINTS:
        bullet.resetJointState(arm.body, joint, q[joint], qd[joint], physicsClientId=arm.client)


def test_inverse_dynamics_agree_with_pinocchio(arm, model, rng):
    data = model.createData()
    for _ in range(5):
        q, qd, qdd = rng.uniform(-0.7, 0.7, (3, 6))
        torque = bullet.calculateInverseDynamics(
            arm.body, q.tolist(), qd.tolist(), qdd.tolist(), physicsClientId=arm.client)
        np.testing.assert_allclose(torque, pin.rnea(model, data, q, qd, qdd), atol=1e-11)


def test_mass_matrix_agrees_with_pinocchio(arm, model, rng):
    data, q = model.createData(), rng.uniform(-0.7, 0.7, 6)
    mass_matrix = bullet.calculateMassMatrix(arm.body, q.tolist(), physicsClientId=arm.client)
    np.testing.assert_allclose(
        np.triu(mass_matrix), np.triu(pin.crba(model, data, q)), atol=1e-12)


def test_step_is_pinocchio_aba_with_symplectic_euler(arm, model, rng):
    """Forces at the tool, at the wrist and at the elbow included."""
    data = model.createData()
    q, qd = rng.uniform(-0.7, 0.7, (2, 6))
    torque, force, push = rng.uniform(-5, 5, 6), rng.uniform(-9, 9, 3), rng.uniform(-9, 9, 3)
    set_state(arm, q, qd)
    pin.framesForwardKinematics(model, data, q)
    tip = model.getFrameId('tip_board')
    pin.computeJointJacobians(model, data, q)
    lever = [pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
             for frame in (tip, model.getFrameId('wrist_point'), model.getFrameId('link3'))]
    arm.push_tool(force.tolist(), data.oMf[tip].translation.tolist())
    arm.push_link(-1, push.tolist(), data.oMi[6].translation.tolist())
    arm.push_link(2, force.tolist(), data.oMi[3].translation.tolist())
    arm.step(torque)
    qdd = pin.aba(model, data, q, qd, torque + (
        lever[0] + lever[2]).T @ force + lever[1].T @ push)
    np.testing.assert_allclose(arm.qd, qd + STEP * qdd, atol=1e-11)
    np.testing.assert_allclose(arm.q, q + STEP * (qd + STEP * qdd), atol=1e-13)


def test_inertia_of_link_3_survives_the_import(arm, robot):
    """It breaks the triangle inequality, for which PyBullet would zero it."""
    for joint in JOINTS:
        found = bullet.getDynamicsInfo(arm.body, joint, physicsClientId=arm.client)[2]
        if joint > 0:
            np.testing.assert_allclose(found, robot.links[joint].inertia, atol=1e-15)
        assert min(found) > 0.0


def test_reset_leaves_nothing_of_the_past(arm):
    states = []
    for _ in range(2):
        arm.reset(np.full(6, 0.1))
        for _ in range(20):
            wrench = arm.step(np.array([5.0, 1.0, 2.0, 0.1, 0.2, 0.3]))
        states.append(np.concatenate((arm.q, arm.qd, wrench)).tobytes())
    assert states[0] == states[1]
