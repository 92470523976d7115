"""The momentum observer, against what really touches a simulated arm."""

from arms import controller_config, HOME, plant_config
from multicontact_control.contact.wrench import make_tool_record
from multicontact_control.control.arm import ArmState
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.flags import RESIDUAL_EXCEEDED
from multicontact_control.paths import find_config_folder
from multicontact_control.records import CONTACT, CONTROL
import numpy as np
from numpy.testing import assert_allclose
import pinocchio as pin
import pytest
from sim_bridge.plant import Plant

H = 0.002
K = 200.0
PUSH_START = 0.55  # the push goes to its size in 0.05 s
FAR = {
    'table': {'point_world': [0.0, 0.55, -5.0]},
    'board': {'point_world': [0.0, 5.0, 0.46]},
}
PUSH = np.array([12.0, -5.0, 8.0])
TOOL_PUSH = np.array([3.0, -6.0, 4.0])


def classic_observer(model, q, v, torque):
    """Return r = K (p_0 - p + int (Gamma + C^T v - g - r) dt), as published, at every sample."""
    data = model.createData()
    n = q.shape[1]
    momenta = []
    rates = []
    for each_q, each_v in zip(q, v):
        upper = np.triu(pin.crba(model, data, each_q))
        M = upper + np.triu(upper, 1).T
        C = pin.computeCoriolisMatrix(model, data, each_q, each_v)
        gravity = pin.computeGeneralizedGravity(model, data, each_q)
        momenta.append(M @ each_v)
        rates.append(C.T @ each_v - gravity)
    residuals = [np.zeros(n)]
    integral = np.zeros(n)
    for k in range(1, len(q)):
        rate = 0.5 * (rates[k] + rates[k - 1])
        integral = integral + H * (torque[k] + rate)
        # r enters its own integral: backward Euler.
        residual = K * (momenta[0] - momenta[k] + integral) / (1.0 + K * H)
        residuals.append(residual)
        integral = integral - H * residual
    return np.array(residuals)


@pytest.fixture
def arm():
    """Return the state of the PUMA, whose momentum observer has a bandwidth of K."""
    config = controller_config()
    controls = np.zeros(1, dtype=CONTROL)
    gravity = np.array(config.robot.gravity_world)
    controls['tool'] = make_tool_record(config.tool, gravity)
    controls['law']['friction_speed'] = 1.0
    controls['momentum']['config']['bandwidth'] = K
    robot = RobotModel(config.robot, find_config_folder())
    arm = ArmState(robot, controls, np.zeros(0, dtype=CONTACT))
    arm.joints['watch']['threshold'] = 1.0
    return arm


@pytest.fixture
def plant():
    """Return an arm that touches no surface, pushed at its wrist from 0.5 s on."""
    config = plant_config(
        'rigid',
        surfaces=FAR,
        substep=2.5e-4,
        push_start=[0.5],
        push_duration=[9.0],
        push_force_world=PUSH.tolist(),
        sensor={'noise': False, 'quantise': False},
    )
    plant = Plant(config, rate=1.0 / H, seed=0)
    yield plant
    plant.close()


def tip_jacobian(model, q):
    """Return the Jacobian of the tool's tip, shape (3, n), world axes."""
    tip = model.getFrameId('tip_board')
    axes = pin.LOCAL_WORLD_ALIGNED
    return pin.computeFrameJacobian(model, model.createData(), q, tip, axes)[:3]


def test_residual_is_what_touches_the_arm_before_its_sensor_and_nothing_else(
    arm, plant
):
    """A swinging arm, its tool pushed all the time, its wrist from 0.5 s on."""
    residuals = []
    exceeded = []
    expected = []
    q = []
    v = []
    torques = []
    sample = plant.reset()
    plant.push(TOOL_PUSH, 9.0, tool=True)
    for k in range(500):
        arm.controls['wrench'] = sample.wrench
        arm.joints['watch']['effort'] = sample.effort
        arm.motion[:] = sample.q, sample.qd
        arm.take_motion()
        arm.controls['momentum']['elapsed'] = H
        state = arm.robot.update(sample.q, sample.qd)
        residuals.append(arm.joints['watch']['residual'].copy())
        exceeded.append(bool(arm.flags & RESIDUAL_EXCEEDED))
        pushed = k * H > PUSH_START
        expected.append(-state.jacobian[:3].T @ PUSH * pushed)
        felt = tip_jacobian(plant.model, sample.q).T @ TOOL_PUSH
        q.append(sample.q)
        v.append(sample.qd)
        torques.append(sample.effort + felt)
        wanted = HOME + 0.15 * np.sin(6.0 * k * H)
        acceleration = 400.0 * (wanted - sample.q) - 40.0 * sample.qd
        swinging = state.mass_matrix @ acceleration
        sample = plant.step(state.gravity + state.coriolis + swinging)
    reference = classic_observer(plant.model, np.array(q), v, torques)
    assert np.abs(v).max() > 0.5
    assert np.abs(expected[300:]).max() > 3.0
    assert_allclose(residuals[20:250], expected[20:250], atol=0.2)
    assert_allclose(residuals[290:], expected[290:], atol=0.2)
    assert_allclose(residuals[20:], reference[20:], atol=0.4)
    assert not any(exceeded[:250])
    assert all(exceeded[253:])
