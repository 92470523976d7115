"""Speeds of the arm and the plausibility of the control law's answer, against numpy."""

from arms import controller_config, HOME
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.control.arm import JOINT_SPEED, OPERATIONAL_SPEED
from multicontact_control.control.tasks import CommandedTask
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.paths import config_dir
from multicontact_control.supervision.checks import (
    check_plausibility,
    NOT_FINITE,
    OUTSIDE,
    plausibility_limits,
    PULL,
    SIDEWAYS,
    TOO_FAST,
)
from multicontact_control.supervision.contacts import LOST, NAMES
from multicontact_control.supervision.supervisor import Supervisor
import numpy as np

BIAS = [0.0, 0.0, 3.0, 0.0, 0.0, 0.0]
CONFIG = controller_config(tool={'bias_sensor': BIAS})
ROBOT = RobotModel(CONFIG.robot, config_dir())
CONTACTS = len(CONFIG.contact_names)
SUPERVISOR = Supervisor(CONFIG, ROBOT, CommandedTask(CONFIG.contact_names))


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2 ** 32 - 1), scale=st.sampled_from([0.1, 1.0, 3.0]))
def test_speeds_and_plausibility_equal_numpy(seed, scale):
    random = np.random.default_rng(seed)
    q, v = HOME + random.normal(size=6), scale * random.normal(size=6)
    arm, limits = SUPERVISOR.controller.arm, CONFIG.limits
    assert arm.update(q, v)
    state = ROBOT.update(q, v)
    np.testing.assert_allclose(arm.frames['twist'][0], state.twist_world, atol=1e-12)
    np.testing.assert_allclose(arm.inertia, np.diagonal(state.mass_matrix), atol=1e-12)
    np.testing.assert_allclose(arm.bias_torque, state.coriolis + state.gravity, atol=1e-11)
    too_fast = []
    if np.linalg.norm(state.twist_world[:3]) > 1.1 * limits.operational_speed or (
            np.linalg.norm(state.twist_world[3:]) > 1.1 * limits.operational_turn):
        too_fast.append('motion_operational_speed')
    if (np.abs(v) > 1.1 * np.array(limits.joint_speed)).any():
        too_fast.append('motion_joint_speed')
    assert list(TOO_FAST[arm.flags & (OPERATIONAL_SPEED | JOINT_SPEED)]) == too_fast

    alpha, wrench = random.normal(size=CONTACTS) * 5.0, random.normal(size=6) * 10.0
    contacts, controls = SUPERVISOR.controller.contacts, SUPERVISOR.controller.controls
    contacts['alpha_meas'], controls['wrench'] = alpha, wrench
    contacts['answer']['innovation'] = 0.0
    arm.joints['torque'] = random.normal(size=6)
    arm.joints['torque'][3] = np.nan if scale == 3.0 else 0.0
    states = random.integers(len(NAMES), size=CONTACTS)
    SUPERVISOR.task.states['state'] = states

    def found():
        return check_plausibility(plausibility_limits(CONFIG), controls, arm.joints,
                                  contacts, SUPERVISOR.task.states)

    # A lost contact reads its tool's inertia at 20 m/s^2; a pull of 4 N and 5 N sideways pass.
    pull = 4.0 + np.where(states == LOST, CONFIG.tool.mass * 20.0, 0.0)
    weight = CONFIG.tool.mass * np.array(CONFIG.robot.gravity_world)
    normals = np.array([CONFIG.contacts[name].normal_world for name in CONFIG.contact_names])
    force = state.sensor_pose.rotation_world @ (wrench[:3] - BIAS[:3])
    sideways = force + weight - alpha @ normals
    bound = 5.0 + CONFIG.watchdog.friction_bound * np.abs(alpha).sum()
    place = state.pose.position_world
    outside = (place < np.array(limits.workspace_lower) - 0.01).any() or (
        place > np.array(limits.workspace_upper) + 0.01).any()
    assert found() == (
        NOT_FINITE * (scale == 3.0) + PULL * bool((alpha < -pull).any())
        + SIDEWAYS * bool(np.linalg.norm(sideways) > bound) + OUTSIDE * bool(outside))
    arm.joints['torque'], contacts['answer']['innovation'][0] = 0.0, np.inf
    assert found() & NOT_FINITE
