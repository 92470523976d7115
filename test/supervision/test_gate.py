"""Checks and limits of each command: the law's answer, and the gate that torques pass."""

from arms import controller_config, HOME
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.control.arm import ArmState
from multicontact_control.control.tasks import CommandedTask
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.flags import (
    ANSWER_NOT_FINITE,
    FORCE_SIDEWAYS,
    JOINT_SPEED,
    OPERATIONAL_SPEED,
    OUTSIDE_WORKSPACE,
    SURFACE_PULLS,
)
from multicontact_control.paths import find_config_folder
from multicontact_control.records import CONTACT, CONTROL
from multicontact_control.supervision.checks import (
    check_plausibility,
    plausibility_limits,
)
from multicontact_control.supervision.contacts import LOST, STATE_NAMES
from multicontact_control.supervision.gate import TorqueGate
from multicontact_control.supervision.supervisor import Supervisor
import numpy as np
import pytest

CONFIG = controller_config()
ROBOT = RobotModel(CONFIG.robot, find_config_folder())
LIMIT = np.array(CONFIG.torque_limit)
REST = np.zeros(6)
START = np.array([1.0, 10.0, 0.0, 0.5, -0.5, 0.1])
TORQUE = np.array([3.0, -40.0, 0.0, 0.2, 0.5, -0.2])


def make(q=HOME, velocity=REST, config=CONFIG, limit=LIMIT, guarded=True):
    """Return a gate, and its arm at a posture."""
    arm = ArmState(ROBOT, np.zeros(1, dtype=CONTROL), np.zeros(0, dtype=CONTACT))
    arm.motion[:] = q, velocity
    assert arm.take_motion()
    joints = arm.joints['config']
    joints['torque_limit'] = limit
    joints['lower'] = config.limits.joint_lower
    joints['upper'] = config.limits.joint_upper
    return TorqueGate(config, arm, guarded=guarded), arm


def passed(gate, law, torque):
    """Return what the gate makes of a torque of a law."""
    gate.apply_torque(law, torque)
    return gate.last.copy()


def blending(**transition):
    """Return a gate that starts from a torque and has no limits."""
    config = controller_config(transition=transition)
    gate, _ = make(config=config, limit=np.inf, guarded=False)
    gate.begin_from(START)
    return gate


@pytest.mark.parametrize('joint', range(6))
def test_gate_stops_a_joint_before_its_stop_whatever_the_others_do(joint):
    """One joint under large torque, the others held, with the arm's own dynamics (Euler)."""
    q = HOME.copy()
    v = np.zeros(6)
    push = np.zeros(6)
    gate, arm = make()
    lower, upper = (
        np.array(getattr(CONFIG.limits, f'joint_{end}')) for end in ('lower', 'upper')
    )
    speed = np.array(CONFIG.limits.joint_speed)
    push[joint] = 0.5 * LIMIT[joint]
    fastest = 0.0
    for _ in range(2500):
        state = ROBOT.update(q, v)
        arm.motion[:] = q, v
        arm.take_motion()
        held = state.mass_matrix @ (400.0 * (HOME - q) - 40.0 * v)
        held[joint] = 0.0
        torque = passed(gate, -2, state.gravity + state.coriolis + held + push)
        v = v + 0.002 * np.linalg.solve(
            state.mass_matrix, torque - state.gravity - state.coriolis
        )
        q = q + 0.002 * v
        fastest = max(fastest, v[joint])
        assert (q < upper).all() and (q > lower).all()
        assert (np.abs(v) < 1.02 * speed).all()
    assert fastest > 0.2
    assert np.abs(v).max() < 0.02
    assert upper[joint] - q[joint] < 0.05


def test_joint_that_starts_at_its_stop_stays_there():
    """It is not led away by the margin that others keep."""
    q = HOME.copy()
    v = np.zeros(6)
    q[4] = start = CONFIG.limits.joint_upper[4] - 0.005
    gate, arm = make(q)
    for _ in range(500):
        state = ROBOT.update(q, v)
        arm.motion[:] = q, v
        arm.take_motion()
        torque = passed(gate, -2, state.gravity + state.coriolis)
        v = v + 0.002 * np.linalg.solve(
            state.mass_matrix, torque - state.gravity - state.coriolis
        )
        q = q + 0.002 * v
    assert abs(q[4] - start) < 1e-4


def test_commanded_change_starts_at_the_torque_before_and_fades_at_its_rate():
    """What the law adds later comes through at once."""
    calm, moved = (blending(blend_time=0.2, torque_rate=100.0) for _ in range(2))
    torques = []
    for gate in (calm, moved):
        gate.start_blend()
        torques = [passed(gate, -1, TORQUE.copy())]
    np.testing.assert_array_equal(torques[0], START)
    np.testing.assert_allclose(
        passed(moved, -1, TORQUE + 0.1) - passed(calm, -1, TORQUE.copy()), 0.1
    )
    while (torques[-1] != TORQUE).any():
        torques.append(passed(calm, -1, TORQUE.copy()))
    assert np.abs(np.diff(torques, axis=0)[1:]).max() <= 100.0 * CONFIG.period * (
        1.0 + 1e-9
    )
    assert len(torques) >= 0.2 / CONFIG.period


def test_change_of_law_is_continuous_and_decays_at_its_declared_rate():
    gate = blending()
    out = [passed(gate, -2, START.copy())]
    out += [passed(gate, -3, TORQUE.copy()) for _ in range(60)]
    np.testing.assert_allclose(out[1], START)
    np.testing.assert_allclose(out[-1], TORQUE, atol=1e-5)
    steps = np.abs(np.diff(out, axis=0))
    assert (steps <= np.abs(START - TORQUE) * CONFIG.period / 0.003 + 1e-12).all()
    before = passed(gate, -4, np.full(6, np.nan))  # the change waits for numbers
    np.testing.assert_allclose(passed(gate, -4, TORQUE.copy()), before, atol=1e-9)


BIAS = [0.0, 0.0, 3.0, 0.0, 0.0, 0.0]
BIASED = controller_config(tool={'bias_sensor': BIAS})
CONTACTS = len(BIASED.contact_names)
SUPERVISOR = Supervisor(
    BIASED, ROBOT, CommandedTask(BIASED.column_names, BIASED.leading_columns)
)


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scale=st.sampled_from([0.1, 1.0, 3.0]))
def test_speeds_and_plausibility_equal_numpy(seed, scale):
    random = np.random.default_rng(seed)
    q = HOME + random.normal(size=6)
    v = scale * random.normal(size=6)
    arm, limits = SUPERVISOR.controller.arm, BIASED.limits
    arm.motion[:] = q, v
    assert arm.take_motion()
    state = ROBOT.update(q, v)
    too_fast = 0
    if np.linalg.norm(state.twist_world[:3]) > 1.1 * limits.operational_speed or (
        np.linalg.norm(state.twist_world[3:]) > 1.1 * limits.operational_turn
    ):
        too_fast += OPERATIONAL_SPEED
    if (np.abs(v) > 1.1 * np.array(limits.joint_speed)).any():
        too_fast += JOINT_SPEED
    assert arm.flags & (OPERATIONAL_SPEED | JOINT_SPEED) == too_fast

    alpha = random.normal(size=CONTACTS) * 5.0
    wrench = random.normal(size=6) * 10.0
    contacts, controls = SUPERVISOR.controller.contacts, SUPERVISOR.controller.controls
    contacts['alpha_meas'], controls['wrench'] = alpha, wrench
    contacts['answer']['innovation'] = 0.0
    arm.joints['answer']['torque'] = random.normal(size=6)
    arm.joints['answer']['torque'][3] = np.nan if scale == 3.0 else 0.0
    states = random.integers(len(STATE_NAMES), size=CONTACTS)
    SUPERVISOR.task.states['state'] = states

    def check():
        return check_plausibility(
            plausibility_limits(BIASED)[0],
            controls[0],
            arm.joints,
            contacts,
            SUPERVISOR.task.states,
            np.empty(6),
        )

    # A lost contact reads its tool's inertia at 20 m/s^2; a pull of 4 N and 5 N sideways pass.
    pull = 4.0 + np.where(states == LOST, BIASED.tool.mass * 20.0, 0.0)
    weight = BIASED.tool.mass * np.array(BIASED.robot.gravity_world)
    normals = np.array(
        [BIASED.contacts[name].normal_world for name in BIASED.contact_names]
    )
    force = state.sensor_pose.rotation_world @ (wrench[:3] - BIAS[:3])
    sideways = force + weight - alpha @ normals
    bound = 5.0 + BIASED.watchdog.friction_bound * np.abs(alpha).sum()
    place = state.pose.position_world
    outside = (place < np.array(limits.workspace_lower) - 0.01).any() or (
        place > np.array(limits.workspace_upper) + 0.01
    ).any()
    assert check() == (
        ANSWER_NOT_FINITE * (scale == 3.0)
        + SURFACE_PULLS * bool((alpha < -pull).any())
        + FORCE_SIDEWAYS * bool(np.linalg.norm(sideways) > bound)
        + OUTSIDE_WORKSPACE * bool(outside)
    )
    arm.joints['answer']['torque'], contacts['answer']['innovation'][0] = 0.0, np.inf
    assert check() & ANSWER_NOT_FINITE
