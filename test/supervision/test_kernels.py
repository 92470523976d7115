"""Compiled supervision against plain Python, over sequences of whatever may come."""

from arms import controller_config, HOME
from contact_machine import ContactMachine, PassivityObserver
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.config import ContactStateConfig
from multicontact_control.control.arm_state import ArmState, JOINT_SPEED, OPERATIONAL_SPEED
from multicontact_control.control.reference import CommandedReference, Reference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.paths import config_dir
from multicontact_control.supervision.contacts import ContactState, LOST
from multicontact_control.supervision.gate import TorqueGate
from multicontact_control.supervision.plausibility import (
    check_plausibility,
    NOT_FINITE,
    OUTSIDE,
    plausibility_limits,
    PULL,
    SIDEWAYS,
    TOO_FAST,
)
from multicontact_control.supervision.reference import ContactReference
from multicontact_control.supervision.supervisor import Supervisor
from multicontact_control.supervision.validation import (
    JointInput,
    TickInputs,
    VarianceInput,
    Watchdog,
    WrenchInput,
)
import numpy as np
from plain_contacts import PlainMachine, PlainObserver, PlainReference
from plain_watch import PlainGate, PlainWatchdog
import pytest
from scipy.spatial.transform import Rotation

H = 0.002
CONFIG = controller_config()
ROBOT = RobotModel(CONFIG.robot, config_dir())
CONTACTS = len(CONFIG.contact_names)
seeds = st.integers(0, 2 ** 32 - 1)

FORCE = st.one_of(st.floats(-3.0, 25.0), st.sampled_from([0.0, 1.0, 15.0, 70.0]))
TICKS = st.lists(st.tuples(
    st.integers(1, 60), st.booleans() | st.just(True), FORCE, st.floats(0.0, 20.0),
    st.floats(-0.03, 0.03), st.floats(-0.05, 0.05), st.floats(-0.05, 0.05) | st.just(0.2),
    st.sampled_from(['', '', '', 'let_go', 'again'])), min_size=1, max_size=25)


@settings(max_examples=300, deadline=None)
@given(ticks=TICKS)
def test_machine_equals_plain_python(ticks):
    config = ContactStateConfig(approach_distance=0.02, lost_time=0.02, retry_time=0.05)
    machine, plain = ContactMachine(config, H, stiffness=6e3), PlainMachine(config, H, 6e3)
    for length, wanted, alpha, alpha_des, place, speed, escape, event in ticks:
        for each in (machine, plain):
            if event == 'let_go':
                each.let_go(place, speed)
            if event == 'again':
                each.again = True
        for _ in range(length):
            machine.update(wanted, alpha, alpha_des, place, speed, escape)
            plain.update(wanted, alpha, alpha_des, place, speed, escape)
            for name in ('state', 'active', 'losses', 'searches', 'displacement', 'speed',
                         'acceleration', 'force_limit'):
                assert getattr(machine, name) == getattr(plain, name), name


@settings(max_examples=100, deadline=None)
@given(seed=seeds, damping=st.floats(0.0, 100.0))
def test_observer_equals_plain_python(seed, damping):
    config = ContactStateConfig(injected_damping=damping, energy_share=30.0)
    observer, plain = PassivityObserver(config, 6000.0, H), PlainObserver(config, 6000.0, H)
    for alpha, speed in np.random.default_rng(seed).normal(size=(100, 2)) * [10.0, 0.1]:
        taken = observer.update(float(alpha), float(speed))
        assert taken == pytest.approx(plain.update(float(alpha), float(speed)), abs=1e-12)
        assert observer.energy == pytest.approx(plain.energy, abs=1e-12)
        assert observer.passive == plain.passive


class WanderingTask(CommandedReference):
    """Asks for poses, motions, contacts and forces that a generator draws."""

    def __init__(self, random):
        super().__init__(CONFIG.contact_names)
        self.random = random
        self.now = None

    def draw(self, around):
        random = self.random
        turn = Rotation.from_rotvec(random.normal(size=3) * random.choice([0.01, 1.0]))
        wanted = random.random(CONTACTS) < 0.8
        self.now = Reference(
            Pose(around + random.normal(size=3) * random.choice([0.001, 0.1]),
                 turn.as_matrix()),
            0.1 * random.normal(size=6), random.normal(size=6), wanted,
            np.where(wanted, 20.0 * random.random(CONTACTS), 0.0))

    def task(self, time):
        return self.now


@settings(max_examples=60, deadline=None)
@given(seed=seeds, box=st.booleans())
def test_reference_equals_plain_python(seed, box):
    limits = {} if box else {'workspace_lower': [], 'workspace_upper': []}
    config = controller_config(limits=limits, contact_state={
        'injected_damping': 20.0, 'energy_share': 1.0})
    random = np.random.default_rng(seed)
    task = WanderingTask(random)
    pair = ContactReference(config, task), PlainReference(config, task)
    normals = np.array([config.contacts[name].normal_world for name in config.contact_names])
    place = np.array([0.0, 0.55, 0.64])
    task.draw(place)
    for each in pair:
        each.start(Pose(place, np.eye(3)), normals)
    alpha, event = np.zeros(CONTACTS), ''
    outputs, energies = ([], []), ([], [])  # compared at once, which takes a fifth of the time
    for k in range(150):
        if k % 10 == 0:
            task.draw(place)
            alpha = random.normal(size=CONTACTS) * 10.0 + 5.0
            event = random.choice(['', '', '', '', 'resume', 'lead_back'])
        pose = Pose(place + 0.02 * random.normal(size=3),
                    Rotation.from_rotvec(0.02 * random.normal(size=3)).as_matrix())
        twist = 0.05 * random.normal(size=6)
        for each in pair:
            each.observe(pose, twist)
            if event:
                getattr(each, event)()
        event = ''
        for each, values in zip(pair, outputs):
            output = each.update(k * H, alpha)
            values.append(np.concatenate(
                [np.ravel(x) for x in (*output.pose_des, *output[1:])]))
        assert pair[0].limited == pair[1].limited
        assert pair[0].states == pair[1].states
        assert pair[0].state_names == tuple(state.value for state in pair[1].states)
        energies[0].append(pair[0].contact_states['energy'].copy())
        energies[1].append([each.energy for each in pair[1].observers])
    # The logarithm of a rotation after a pause is pinocchio's, to 3e-12.
    np.testing.assert_allclose(*outputs, rtol=0.0, atol=2e-11)
    np.testing.assert_allclose(*energies, atol=1e-12)


ANY = st.lists(st.one_of(st.floats(width=64), st.floats(-60.0, 60.0)), min_size=6, max_size=6)


@settings(max_examples=200, deadline=None)
@given(torques=st.lists(ANY, min_size=1, max_size=6), fallback=ANY, seed=seeds,
       known=st.booleans())
def test_gate_equals_plain_python(torques, fallback, seed, known):
    random = np.random.default_rng(seed)
    gate, plain = TorqueGate(CONFIG, 6), PlainGate(CONFIG, 6)
    arm = ArmState(ROBOT)
    with np.errstate(all='ignore'):
        for torque in torques:
            q, v = HOME + random.normal(size=6), 2.0 * random.normal(size=6)
            arm.update(q, v)
            arguments = np.array(torque), np.array(fallback), arm if known else None
            found, wanted = gate.apply(*arguments), plain.apply(*arguments)
            np.testing.assert_array_equal(found[0], wanted[0])
            assert found[1] == wanted[1]


KINDS = ('late', 'nan', 'jump', 'frozen', 'lost', 'huge', 'order', 'future', 'no stamp')
TIMES = ('still', 'back', 'slow', 'nan')


def inputs_at(random, k, now, kind):
    """Return the inputs of a tick with something wrong in one of them, or nothing."""
    what = random.choice(['joints', 'wrench', 'variance'])
    stamp = k * H - {
        'late': 0.004, 'order': 0.02, 'future': -0.02, 'no stamp': np.nan}.get(kind, 0.0)
    if kind == 'lost':
        return now._replace(time=k * H, **{what: None})
    if kind != 'frozen':
        q = HOME + 1e-3 * np.sin(k * H) + 1e-9 * random.normal(size=6)
        now = TickInputs(
            k * H, JointInput(k * H, q, 1e-3 * np.cos(k * H) + 1e-6 * random.normal(size=6)),
            WrenchInput(k * H, random.normal(size=6)),
            VarianceInput((k - 1) * H, random.random(CONTACTS)))
    reading = getattr(now, what)
    if kind == 'good' or reading is None:
        return now._replace(time=k * H)
    values = list(reading)
    values[0] = stamp
    if kind in ('nan', 'jump', 'huge'):
        values[1] = values[1].copy()
        values[1][random.integers(CONTACTS)] += {
            'nan': np.nan, 'jump': random.choice([0.5, 0.012, 0.03]), 'huge': 1e9}[kind]
    return now._replace(time=k * H, **{what: type(reading)(*values)})


@settings(max_examples=150, deadline=None)
@given(seed=seeds)
def test_watchdog_equals_plain_python(seed):
    random = np.random.default_rng(seed)
    watchdog, plain = Watchdog(CONFIG), PlainWatchdog(CONFIG)
    now, kind = TickInputs(0.0), 'good'
    valid = [np.zeros(0)], [np.zeros(0)]  # compared at once, which takes a fifth of the time
    for k in range(150):
        if random.random() < 0.3:
            kind = random.choice(['good', *KINDS])
        now = inputs_at(random, k, now, kind)
        if random.random() < 0.1:
            now = now._replace(time={
                'still': (k - 1) * H, 'back': 0.0, 'slow': (k + 2) * H, 'nan': np.nan}[
                    random.choice(TIMES)])
        found, wanted = watchdog.validate(now), plain.validate(now)
        assert (found.causes, found.rejected, found.repeated, found.blind) == (
            wanted.causes, wanted.rejected, wanted.repeated, wanted.blind)
        assert wanted.repeated or found.measured == wanted.measured
        for mine, other in ((found.q, wanted.q), (found.qd, wanted.qd),
                            (found.wrench, wanted.wrench), (found.variance, wanted.variance)):
            assert (mine is None) == (other is None)
            if mine is not None:
                valid[0].append(np.array(mine))
                valid[1].append(np.array(other))
    np.testing.assert_allclose(*map(np.concatenate, valid), rtol=1e-15)


@settings(max_examples=100, deadline=None)
@given(seed=seeds, scale=st.sampled_from([0.1, 1.0, 3.0]))
def test_speeds_and_plausibility_equal_numpy(seed, scale):
    random = np.random.default_rng(seed)
    q, v = HOME + random.normal(size=6), scale * random.normal(size=6)
    config = controller_config(tool={'bias_sensor': [0.0, 0.0, 3.0, 0.0, 0.0, 0.0]})
    supervisor = Supervisor(config, ROBOT, CommandedReference(CONFIG.contact_names))
    arm = supervisor.controller.arm
    assert arm.update(q, v)
    state = ROBOT.update(q, v)
    np.testing.assert_allclose(arm.twist_world, state.twist_world, atol=1e-12)
    np.testing.assert_allclose(arm.inertia, np.diagonal(state.mass_matrix), atol=1e-12)
    np.testing.assert_allclose(arm.bias_torque, state.coriolis + state.gravity, atol=1e-11)
    too_fast = []
    if np.linalg.norm(state.twist_world[:3]) > 1.1 * CONFIG.limits.operational_speed or (
            np.linalg.norm(state.twist_world[3:]) > 1.1 * CONFIG.limits.operational_turn):
        too_fast.append('motion_operational_speed')
    if (np.abs(v) > 1.1 * np.array(CONFIG.limits.joint_speed)).any():
        too_fast.append('motion_joint_speed')
    assert list(TOO_FAST[arm.found & (OPERATIONAL_SPEED | JOINT_SPEED)]) == too_fast

    alpha, wrench = random.normal(size=CONTACTS) * 5.0, random.normal(size=6) * 10.0
    contacts, controls = supervisor.controller.contacts, supervisor.controller.controls
    contacts['alpha_meas'], controls['wrench'] = alpha, wrench
    arm.joints['torque'] = random.normal(size=6)
    arm.joints['torque'][3] = np.nan if scale == 3.0 else 0.0
    watch = CONFIG.watchdog
    states = random.integers(len(ContactState), size=CONTACTS)
    supervisor.reference.contact_states['state'] = states

    def found():
        return check_plausibility(
            plausibility_limits(config)[0], controls[0], arm.joints, contacts,
            supervisor.reference.contact_states)

    pull = watch.pull_threshold + np.where(
        states == LOST, CONFIG.tool.mass * watch.loss_acceleration, 0.0)
    weight = CONFIG.tool.mass * np.array(CONFIG.robot.gravity_world)
    normals = np.array([CONFIG.contacts[name].normal_world for name in CONFIG.contact_names])
    bias = np.array([0.0, 0.0, 3.0])
    sideways = state.sensor_pose.rotation_world @ (wrench[:3] - bias) + weight - alpha @ normals
    bound = watch.friction_offset + watch.friction_bound * np.abs(alpha).sum()
    place = state.pose.position_world
    outside = (place < np.array(CONFIG.limits.workspace_lower) - 0.01).any() or (
        place > np.array(CONFIG.limits.workspace_upper) + 0.01).any()
    assert found() == (
        NOT_FINITE * (scale == 3.0) + PULL * bool((alpha < -pull).any())
        + SIDEWAYS * bool(np.linalg.norm(sideways) > bound) + OUTSIDE * bool(outside))
    arm.joints['torque'], contacts['innovation'][0] = 0.0, np.inf
    assert found() & NOT_FINITE


def test_arm_whose_model_gives_no_numbers_stays_as_it_was_seen():
    arm, still = ArmState(ROBOT), np.zeros(6)
    assert arm.update(HOME, still)
    before = arm.joints.tobytes(), arm.frames.tobytes()
    assert not arm.update(np.full(6, np.nan), still)
    assert (arm.joints.tobytes(), arm.frames.tobytes()) == before
    assert not arm.finite
