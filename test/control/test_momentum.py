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
from sim_bridge.plant import Plant

H, K = 0.002, 200.0
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
    momenta, rates = [], []
    for each_q, each_v in zip(q, v):
        M = pin.crba(model, data, each_q)
        M = np.triu(M) + np.triu(M, 1).T
        C = pin.computeCoriolisMatrix(model, data, each_q, each_v)
        momenta.append(M @ each_v)
        rates.append(C.T @ each_v - pin.computeGeneralizedGravity(model, data, each_q))
    residuals = [np.zeros(n)]
    integral = np.zeros(n)
    for k in range(1, len(q)):
        integral = integral + H * (torque[k] + 0.5 * (rates[k] + rates[k - 1]))
        # r enters its own integral: backward Euler.
        residuals.append((K * (momenta[0] - momenta[k] + integral)) / (1.0 + K * H))
        integral = integral - H * residuals[-1]
    return np.array(residuals)


def test_residual_is_what_touches_the_arm_before_its_sensor_and_nothing_else():
    """A swinging arm, its tool pushed all the time, its wrist from 0.5 s on."""
    config = controller_config()
    robot = RobotModel(config.robot, find_config_folder())
    controls = np.zeros(1, dtype=CONTROL)
    controls['tool'] = make_tool_record(
        config.tool, np.array(config.robot.gravity_world)
    )
    controls['law']['friction_speed'] = 1.0
    controls['momentum']['config']['bandwidth'] = K
    arm = ArmState(robot, controls, np.zeros(0, dtype=CONTACT))
    arm.joints['watch']['threshold'] = 1.0
    plant = Plant(
        plant_config(
            'rigid',
            surfaces=FAR,
            substep=2.5e-4,
            push_start=[0.5],
            push_duration=[9.0],
            push_force_world=PUSH.tolist(),
            sensor={'noise': False, 'quantise': False},
        ),
        rate=1.0 / H,
        seed=0,
    )
    rows = []
    tip = plant.model.getFrameId('tip_board')
    try:
        sample = plant.reset()
        plant.push(TOOL_PUSH, 9.0, tool=True)
        for k in range(500):
            controls['wrench'] = sample.wrench
            arm.joints['watch']['effort'] = sample.effort
            controls['momentum']['elapsed'] = H if k else 0.0
            arm.motion[:] = sample.q, sample.qd
            arm.take_motion()
            state = robot.update(sample.q, sample.qd)
            felt = (
                pin.computeFrameJacobian(
                    plant.model,
                    plant.model.createData(),
                    sample.q,
                    tip,
                    pin.LOCAL_WORLD_ALIGNED,
                )[:3].T
                @ TOOL_PUSH
            )
            residual = arm.joints['watch']['residual'].copy()
            rows.append(
                (
                    residual,
                    bool(arm.flags & RESIDUAL_EXCEEDED) * np.ones(6),
                    -state.jacobian[:3].T @ PUSH * (k * H > 0.55),
                    sample.q,
                    sample.qd,
                    sample.effort + felt,
                )
            )
            wanted = HOME + 0.15 * np.sin(6.0 * k * H)
            sample = plant.step(
                state.gravity
                + state.coriolis
                + state.mass_matrix @ (400.0 * (wanted - sample.q) - 40.0 * sample.qd)
            )
        residuals, touched, expected, q, v, torque = np.swapaxes(rows, 0, 1)
        reference = classic_observer(plant.model, q, v, torque)
    finally:
        plant.close()
    assert np.abs(v).max() > 0.5
    assert np.abs(expected[300:]).max() > 3.0
    assert_allclose(residuals[20:250], expected[20:250], atol=0.2)
    assert_allclose(residuals[290:], expected[290:], atol=0.2)
    assert_allclose(residuals[20:], reference[20:], atol=0.4)
    assert not touched[:250].any()
    assert touched[253:].all()
