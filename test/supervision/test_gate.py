"""Checks and limits of each command: the law's answer, and the gate that torques pass."""

from arms import controller_config, HOME
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.control.arm import ArmState
from multicontact_control.control.tasks import CommandedTask
from multicontact_control.dynamics.operational_space import INERTIA_SPACE
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
from multicontact_control.supervision.gate import begin_torque, pass_gate, TorqueGate
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
    gate = TorqueGate(config, arm, guarded=guarded)
    gate.arm = arm
    return gate, arm


def passed(gate, law, torque):
    """Return what the gate makes of a torque of a law, at joints that are seen."""
    arm = gate.arm
    arm.joints['answer']['torque'] = torque
    gate.records['seen'] = True
    pass_gate(
        gate.records[0],
        arm.joints,
        arm.controls[0],
        arm.contacts,
        ROBOT.terms,
        np.zeros(1, dtype=INERTIA_SPACE)[0],
        law,
    )
    return gate.last.copy()


class GatedArm:
    """The arm's own dynamics (Euler) under torques that pass a gate, from rest."""

    def __init__(self, q):
        self.gate, self.arm = make(q)
        self.q = q
        self.v = np.zeros(6)

    def step(self, stiffness, push):
        """Advance 2 ms under a push [N m], the joints of a stiffness held at HOME."""
        state = ROBOT.update(self.q, self.v)
        self.arm.motion[:] = self.q, self.v
        self.arm.take_motion()
        bias = state.gravity + state.coriolis
        held = state.mass_matrix @ (stiffness * (HOME - self.q) - 40.0 * self.v)
        held[stiffness == 0.0] = 0.0
        torque = passed(self.gate, -2, bias + held + push)
        acceleration = np.linalg.solve(state.mass_matrix, torque - bias)
        self.v = self.v + 0.002 * acceleration
        self.q = self.q + 0.002 * self.v


def blending(**transition):
    """Return a gate that starts from a torque and has no limits."""
    config = controller_config(transition=transition)
    gate, _ = make(config=config, limit=np.inf, guarded=False)
    begin_torque(gate.records[0], gate.arm.joints, START)
    return gate


@pytest.mark.parametrize('joint', range(6))
def test_gate_stops_a_joint_before_its_stop_whatever_the_others_do(joint):
    """One joint under large torque, the others held."""
    lower = np.array(CONFIG.limits.joint_lower)
    upper = np.array(CONFIG.limits.joint_upper)
    speed = np.array(CONFIG.limits.joint_speed)
    stiffness = np.full(6, 400.0)
    stiffness[joint] = 0.0
    push = np.zeros(6)
    push[joint] = 0.5 * LIMIT[joint]
    arm = GatedArm(HOME.copy())
    fastest = 0.0
    for _ in range(2500):
        arm.step(stiffness, push)
        fastest = max(fastest, arm.v[joint])
        assert (arm.q < upper).all()
        assert (arm.q > lower).all()
        assert (np.abs(arm.v) < 1.02 * speed).all()
    assert fastest > 0.2
    assert np.abs(arm.v).max() < 0.02
    assert upper[joint] - arm.q[joint] < 0.05


def test_joint_that_starts_at_its_stop_stays_there():
    """It is not led away by the margin that others keep."""
    start = CONFIG.limits.joint_upper[4] - 0.005
    q = HOME.copy()
    q[4] = start
    arm = GatedArm(q)
    for _ in range(500):
        arm.step(stiffness=np.zeros(6), push=REST)
    assert abs(arm.q[4] - start) < 1e-4


def test_commanded_change_starts_at_the_torque_before_and_fades_at_its_rate():
    """What the law adds later comes through at once."""
    calm = blending(blend_time=0.2, torque_rate=100.0)
    moved = blending(blend_time=0.2, torque_rate=100.0)
    for gate in (calm, moved):
        gate.start_blend()
        np.testing.assert_array_equal(passed(gate, -1, TORQUE), START)
    torques = [passed(calm, -1, TORQUE)]
    added = passed(moved, -1, TORQUE + 0.1) - torques[0]
    np.testing.assert_allclose(added, 0.1)
    while (torques[-1] != TORQUE).any():
        torques.append(passed(calm, -1, TORQUE))
    steps = np.diff(torques, axis=0)
    assert np.abs(steps).max() <= 100.0 * CONFIG.period * (1.0 + 1e-9)
    assert len(torques) >= 0.2 / CONFIG.period


def test_change_of_law_is_continuous_and_decays_at_its_declared_rate():
    gate = blending()
    out = [passed(gate, -2, START)]
    out += [passed(gate, -3, TORQUE) for _ in range(60)]
    np.testing.assert_allclose(out[1], START)
    np.testing.assert_allclose(out[-1], TORQUE, atol=1e-5)
    steps = np.abs(np.diff(out, axis=0))
    largest_step = np.abs(START - TORQUE) * CONFIG.period / 0.003
    assert (steps <= largest_step + 1e-12).all()
    before = passed(gate, -4, np.full(6, np.nan))  # the change waits for numbers
    np.testing.assert_allclose(passed(gate, -4, TORQUE), before, atol=1e-9)


BIAS = [0.0, 0.0, 3.0, 0.0, 0.0, 0.0]
BIASED = controller_config(tool={'bias_sensor': BIAS})
CONTACTS = len(BIASED.contact_names)
SUPERVISOR = Supervisor(
    BIASED, ROBOT, CommandedTask(BIASED.column_names, BIASED.leading_columns)
)
ARM = SUPERVISOR.controller.arm
NORMALS = np.array(
    [BIASED.contacts[name].normal_world for name in BIASED.contact_names]
)


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scale=st.sampled_from([0.1, 1.0, 3.0]))
def test_speeds_that_are_too_fast_equal_numpy(seed, scale):
    random = np.random.default_rng(seed)
    q = HOME + random.normal(size=6)
    v = scale * random.normal(size=6)
    limits = BIASED.limits
    state = ROBOT.update(q, v)
    ARM.motion[:] = q, v
    assert ARM.take_motion()
    tool_speed, tool_turn = np.linalg.norm(state.twist_world.reshape(2, 3), axis=1)
    joint_speed = np.array(limits.joint_speed)
    too_fast = 0
    if tool_speed > 1.1 * limits.operational_speed:
        too_fast |= OPERATIONAL_SPEED
    if tool_turn > 1.1 * limits.operational_turn:
        too_fast |= OPERATIONAL_SPEED
    if (np.abs(v) > 1.1 * joint_speed).any():
        too_fast |= JOINT_SPEED
    assert ARM.flags & (OPERATIONAL_SPEED | JOINT_SPEED) == too_fast


def check():
    """Return what is found in the answer in the supervisor's records."""
    controller = SUPERVISOR.controller
    return check_plausibility(
        plausibility_limits(BIASED)[0],
        controller.controls[0],
        ARM.joints,
        controller.contacts,
        SUPERVISOR.task.states,
        np.empty(6),
    )


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), valid=st.booleans())
def test_plausibility_of_an_answer_equals_numpy(seed, valid):
    """The law's torque may be no number."""
    random = np.random.default_rng(seed)
    q = HOME + random.normal(size=6)
    state = ROBOT.update(q, REST)
    ARM.motion[:] = q, REST
    assert ARM.take_motion()
    alpha = random.normal(size=CONTACTS) * 5.0
    wrench = random.normal(size=6) * 10.0
    contacts = SUPERVISOR.controller.contacts
    contacts['alpha_meas'] = alpha
    contacts['answer']['innovation'] = 0.0
    SUPERVISOR.controller.controls['wrench'] = wrench
    torque = random.normal(size=6)
    if not valid:
        torque[3] = np.nan
    ARM.joints['answer']['torque'] = torque
    states = random.integers(len(STATE_NAMES), size=CONTACTS)
    SUPERVISOR.task.states['state'] = states

    # A lost contact reads its tool's inertia at 20 m/s^2; a pull of 4 N and 5 N sideways pass.
    pull = 4.0 + np.where(states == LOST, BIASED.tool.mass * 20.0, 0.0)
    weight = BIASED.tool.mass * np.array(BIASED.robot.gravity_world)
    force = state.sensor_pose.rotation_world @ (wrench[:3] - BIAS[:3])
    sideways = force + weight - alpha @ NORMALS
    bound = 5.0 + BIASED.watchdog.friction_bound * np.abs(alpha).sum()
    place = state.pose.position_world
    lower = np.array(BIASED.limits.workspace_lower) - 0.01
    upper = np.array(BIASED.limits.workspace_upper) + 0.01
    expected = 0
    if not valid:
        expected |= ANSWER_NOT_FINITE
    if (alpha < -pull).any():
        expected |= SURFACE_PULLS
    if np.linalg.norm(sideways) > bound:
        expected |= FORCE_SIDEWAYS
    if (place != np.clip(place, lower, upper)).any():
        expected |= OUTSIDE_WORKSPACE
    assert check() == expected
    ARM.joints['answer']['torque'] = 0.0
    contacts['answer']['innovation'][0] = np.inf
    assert check() & ANSWER_NOT_FINITE
