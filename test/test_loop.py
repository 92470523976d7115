"""A control loop between activation and deactivation, with its supervisor, without middleware."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from arms import HOME, pressed_wrench, still_config
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.compiled import count_compilations
from multicontact_control.errors import CalibrationError, CommandError, ConfigError
from multicontact_control.loop import ControlLoop
from multicontact_control.paths import find_config_folder
from multicontact_control.sampling import Action, SampleTiming
from multicontact_control.sensor.push_test import PushTestConfig
from multicontact_control.sensor.tool import predict_weight_reading
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

H = 0.002
PERIOD = 2_000_000
ORIGIN = 86_400 * 10**9  # where the stamps start
REST = np.zeros(6)
EFFORT = np.array([1.0, 29.0, 7.0, 0.5, 0.5, 0.1])
BARE = pytest.mark.parametrize('supervised', [True, False])


class Bench:
    """A loop with the timing before it, and an arm at home that feels what a test puts there."""

    def __init__(self, *, supervised=True, **changes):
        self.config = still_config(**changes)
        self.loop = ControlLoop(
            self.config,
            None,
            CommandLimits(),
            find_config_folder(),
            supervised=supervised,
        )
        self.timing = SampleTiming(
            self.config.rate, supervised=supervised, patience=1.5
        )
        self.state = self.loop.supervisor.controller.robot.update(HOME, REST)
        self.weight = predict_weight_reading(
            self.state.sensor_pose.rotation_world,
            self.config.tool,
            np.array(self.config.robot.gravity_world),
        )
        self.random = np.random.default_rng(0)
        self.k = 0
        self.push = np.zeros(6)

    @property
    def stamp(self):
        return ORIGIN + self.k * PERIOD

    def wrench(self):
        return self.weight + self.push + 0.02 * self.random.standard_normal(6)

    def step(self, n=1, effort=EFFORT, wrench=None, q=HOME, qd=REST, change=None):
        """Answer samples, after a change of them if there is one; return the last torque."""
        for _ in range(n):
            self.timing.add_reading(JointInput(self.stamp, q.copy(), qd, effort))
            reading = wrench
            if wrench is None:
                reading = self.wrench()
            self.timing.add_reading(WrenchInput(self.stamp, reading))
            action, inputs = self.timing.decide_on_message(self.stamp)
            assert action is Action.STEP
            if change:
                inputs = change(inputs)
            torque = self.loop.step(inputs)
            self.timing.add_noise_variance(self.stamp, np.full(2, 0.6))
            self.k += 1
        return torque

    def step_half(self, *, joints=True):
        """Answer half of a sample whose other half does not come."""
        if joints:
            self.timing.add_reading(JointInput(self.stamp, HOME.copy(), REST))
        else:
            self.timing.add_reading(WrenchInput(self.stamp, self.wrench()))
        action, inputs = self.timing.decide_on_silence(self.timing.silence_deadline)
        assert action is Action.STEP_BY_HALF
        self.k += 1
        return self.loop.step(inputs)

    def step_without(self):
        """Let time pass until there is a tick without a sample."""
        action = Action.WAIT
        while action is Action.WAIT:
            action, inputs = self.timing.decide_on_silence(self.timing.silence_deadline)
        assert action is Action.STEP_WITHOUT_SAMPLE
        return self.loop.step(inputs)

    def press(self, name, force):
        """Let the sensor feel the force of a contact."""
        self.push = pressed_wrench(self.config, self.state, **{name: force})

    @property
    def reaction(self):
        return self.loop.status.reaction

    @property
    def states(self):
        return dict(zip(self.config.contact_names, self.loop.status.contact_states))

    def command_force(self):
        self.loop.set_forces({'table': 5.0})

    def command_hold(self):
        self.loop.hold(True)

    def assert_refused(self, match, *commands):
        """Check that commands are refused; by default a force, a hold."""
        for command in commands or (self.command_force, self.command_hold):
            with pytest.raises(CommandError, match=match):
                command()


def make_contact(bench, force=6.0):
    bench.step(5)
    bench.loop.set_forces({'table': force})
    bench.step(2)
    assert bench.states['table'] == 'approaching'
    bench.press('table', force)
    bench.step(60)
    assert bench.states['table'] == 'holding'
    assert bench.loop.output.answer['alpha_des'][0] == pytest.approx(force)


def test_loop_seeks_holds_and_releases_a_commanded_force_and_forgets_it_at_a_restart():
    bench = Bench()
    make_contact(bench)
    bench.loop.set_forces({'table': 0.0})
    bench.step(2)
    assert bench.states['table'] == 'free'
    assert not bench.loop.output.answer['alpha_des'].any()
    bench.push = np.zeros(6)
    make_contact(bench)
    bench.push = np.zeros(6)
    bench.loop.restart()
    bench.timing.restart()
    assert_array_equal(bench.step(effort=-EFFORT), -EFFORT)
    assert bench.states['table'] == 'free'


@BARE
@pytest.mark.parametrize('effort', [EFFORT, None, np.full(6, np.nan), np.zeros(6)])
def test_first_command_is_the_measured_effort_or_gravity_compensation(
    effort, supervised
):
    torque = Bench(supervised=supervised).step(effort=effort)
    expected = Bench().state.gravity
    if effort is EFFORT:
        expected = EFFORT
    assert_allclose(torque, expected, rtol=0.0, atol=1e-9)


def test_reconfigure_repeats_the_last_command_and_a_refusal_changes_nothing():
    bench = Bench()
    make_contact(bench)
    before = bench.step()
    known = bench.loop.supervisor.controller.laws['observer'].copy()
    force = {'time_constant': 0.05}
    config = still_config(force=force, motion={'natural_frequency': 15.0})
    bench.loop.reconfigure(config)
    assert bench.loop.config is config
    new = bench.loop.supervisor.controller.laws['observer']
    gain = new['design']['feedback'][:, 0]
    assert (gain < known['design']['feedback'][:, 0]).all()
    assert known['x_est'][0].any()
    for name in ('x_est', 'P', 'running'):
        assert_array_equal(known[name], new[name])
    assert_array_equal(bench.step(), before)
    bench.step(200)
    assert bench.states['table'] == 'holding'
    with pytest.raises(ConfigError, match='^rate: .*cannot change'):
        bench.loop.reconfigure(still_config(rate=400.0))
    assert bench.loop.config is config


def test_tool_of_an_impossible_mass_or_in_a_push_test_is_refused():
    bench = Bench(tool={'mass': 5.0})
    other = still_config(tool={'mass': 4.0})
    bench.step(5)
    with pytest.raises(ConfigError, match='tool.mass: expected above 4.419 kg, got 4'):
        bench.loop.reconfigure(other)
    bench.loop.push_test(PushTestConfig())
    bench.assert_refused(
        '^tool: wait: .*push test', lambda: bench.loop.reconfigure(other)
    )


@pytest.mark.parametrize('required', [True, False])
@pytest.mark.parametrize('ticks', [10, 600])
def test_push_test_without_pushes_can_be_cancelled(required, ticks):
    """While it is under way, or when it has ended after 1 s."""
    bench = Bench(sensor={'require_push_test': required})
    bench.step(5)
    config = PushTestConfig(timeout=0.5)
    for _ in range(2):
        bench.loop.push_test(config)
        bench.step(ticks)
        bench.assert_refused('~/push_test: pass it first')
    ended = 'repeat it, or cancel it' in bench.loop.push_gate.instruction
    assert ended is (ticks == 600)
    text = bench.loop.cancel_push_test()
    assert (text == 'push test cancelled') is not required
    bench.step(5)
    if required:
        bench.assert_refused('~/push_test: pass it first: force control is disabled')
    else:
        bench.loop.set_forces({'table': 8.0})
    bench.assert_refused('push test: none is under way', bench.loop.cancel_push_test)


def test_push_test_with_a_verdict_on_the_sensor_cannot_be_cancelled():
    bench = Bench(sensor={'require_push_test': False})
    bench.step(5)
    bench.loop.push_test(PushTestConfig())
    bench.step(5, wrench=np.full(6, np.nan))
    bench.step(5)
    bench.assert_refused('push test: none is under way', bench.loop.cancel_push_test)


@BARE
@pytest.mark.parametrize(
    'kind', ['gravity_compensation', 'zero_torque', 'hold_position']
)
def test_stop_leads_from_the_last_command_to_the_declared_behaviour(kind, supervised):
    bench = Bench(
        supervised=supervised, safe_behaviour=kind, transition={'blend_time': 0.05}
    )
    last = bench.step(effort=EFFORT)
    torques = [bench.loop.stop()]
    for _ in range(400):
        torques.append(bench.step())
    assert_array_equal(torques[0], last)
    rate = bench.config.transition.torque_rate
    assert np.abs(np.diff(torques, axis=0)).max() <= rate * H * (1.0 + 1e-9)
    expected = bench.state.gravity
    if kind == 'zero_torque':
        expected = np.zeros(6)
    assert_allclose(torques[-1], expected, atol=1e-9)


@pytest.mark.parametrize(
    ('kind', 'held', 'braked'),
    [
        ('gravity_compensation', False, True),
        ('zero_torque', False, False),
        ('hold_position', True, True),
    ],
)
def test_stopped_joint_that_is_pushed_is_braked_and_pulled_back_as_declared(
    kind, held, braked
):
    """Without a supervisor, which takes no velocity from a change of the position."""
    bench = Bench(supervised=False, safe_behaviour=kind)
    bench.step(effort=EFFORT)
    bench.loop.stop()
    bench.step(400)
    sixth = np.eye(6)[5]
    assert (bench.step(q=HOME + 0.05 * sixth)[5] < -0.1) == held
    assert (bench.step(qd=sixth)[5] < -0.1) == braked


def put(source, **values):
    """Return a step whose sample has other values in one reading."""

    def change(inputs):
        reading = getattr(inputs, source)._replace(**values)
        return inputs._replace(**{source: reading})

    return partial(Bench.step, change=change)


def leave_out_variance(inputs):
    return inputs._replace(variance=None)


class Fault(NamedTuple):
    """What is wrong with samples, and the reaction once some ticks have been bridged."""

    step: Callable
    reaction: str
    cause: str
    bridged: int = 0


FAULTS = {
    'no sample': Fault(Bench.step_without, 'float', 'joints_stale'),
    'no joints': Fault(
        partial(Bench.step_half, joints=False), 'float', 'joints_stale', 1
    ),
    'no wrench': Fault(Bench.step_half, 'hold', 'wrench_stale', 12),
    'no variance': Fault(
        partial(Bench.step, change=leave_out_variance), 'inflate', 'variance_stale', 3
    ),
    'joints NaN': Fault(
        put('joints', q=np.full(6, np.nan)), 'float', 'joints_invalid', 1
    ),
    'wrench NaN': Fault(
        put('wrench', wrench=np.full(6, np.nan)), 'hold', 'wrench_invalid', 12
    ),
    'wrench saturated': Fault(
        put('wrench', wrench=100.0 * np.eye(6)[0]), 'hold', 'wrench_saturated', 1
    ),
    'wrench frozen': Fault(
        put('wrench', wrench=np.ones(6)), 'hold', 'wrench_frozen', 3
    ),
}


@pytest.mark.parametrize('fault', FAULTS)
def test_fault_is_bridged_and_reacted_to_and_recovery_has_no_jump(fault):
    """A torque changes by less than 3 % of its limit from tick to tick through it all."""
    step, reaction, cause, bridged = FAULTS[fault]
    bench = Bench()
    reactions = []
    make_contact(bench)
    torques = [bench.step()]
    for _ in range(bridged + 29):
        torques.append(step(bench))
        reactions.append(bench.reaction)
    assert {*reactions[:bridged]} <= {'none', 'inflate'}
    assert reactions[bridged:] == [reaction] * 29
    assert cause in bench.loop.status.causes
    for _ in range(100):
        torques.append(bench.step())
    assert bench.reaction == 'none'
    limit = np.array(bench.config.torque_limit)
    changes = np.abs(np.diff(torques, axis=0)) / limit
    assert changes.max() < 0.03


NUMBERS = st.lists(st.one_of(st.floats(), st.floats(-10, 10)), max_size=7) | st.lists(
    st.floats(), min_size=6, max_size=6
)
SIX = st.lists(st.floats(-7, 7), min_size=6, max_size=6)
STAMP = st.floats()
TICK = st.builds(
    TickInputs,
    STAMP,
    st.none() | st.builds(JointInput, STAMP, NUMBERS, NUMBERS, NUMBERS),
    st.none() | st.builds(WrenchInput, STAMP, NUMBERS),
    st.none() | st.builds(VarianceInput, STAMP, NUMBERS),
)
FUZZED = Bench(collision={'threshold': [30.0] * 6})


@settings(max_examples=250)
@given(
    q=st.just(HOME) | SIX,
    qd=st.just(REST) | SIX,
    force=SIX,
    kept=st.integers(0, 15),
    cases=st.lists(TICK, max_size=8),
    warm=st.integers(0, 5),
)
def test_loop_commands_finite_torques_within_limits_for_any_input(
    q, qd, force, kept, cases, warm
):
    """Singular postures, beyond the stops, faster than allowed; readings of any numbers."""
    loop = FUZZED.loop
    limits = FUZZED.config.limits
    torques = []
    loop.restart()
    for k, case in enumerate([None] * warm + cases + [None] * 3):
        time = k * H
        inputs = TickInputs(
            time,
            JointInput(time, np.array(q) + time * np.array(qd), np.array(qd)),
            WrenchInput(time, FUZZED.wrench() + 10.0 * np.array(force)),
            VarianceInput(time - H, np.full(2, 0.6)),
        )
        if case is not None:  # some parts are right
            for i, name in enumerate(('time', 'joints', 'wrench', 'variance')):
                if not kept >> i & 1:
                    inputs = inputs._replace(**{name: getattr(case, name)})
        torques.append(loop.step(inputs))
        output = loop.output
        for values in (
            output.contacts['alpha_meas'],
            output.answer['alpha_est'],
            output.answer['alpha_des'],
            *output.pose,
            *output.pose_des,
        ):
            assert np.isfinite(values).all()
    assert np.isfinite(torques).all()
    assert (np.abs(torques) <= FUZZED.config.torque_limit).all()
    steps = np.array(limits.torque_rate) * H
    assert (np.abs(np.diff(torques, axis=0)) <= steps * (1.0 + 1e-9)).all()


def test_events_are_at_the_time_of_their_samples_when_a_simulator_has_paused():
    bench = Bench()
    bench.step(100)
    paused = bench.k
    for _ in range(500):
        bench.step_without()
    bench.step(500)
    assert bench.loop.time == pytest.approx((bench.k - 1 + 500) * H, abs=2 * H)
    events = bench.loop.events.events
    begin = next(time for time, what in events if not what.startswith('none'))
    assert round(begin / H) == paused - 1  # of the last sample before the pause
    end, what = events[-1]
    assert what.startswith('none')
    assert paused < round(end / H) < bench.k


def test_no_tick_compiles_anything():
    """In any reaction: it would take seconds."""
    bench = Bench()
    before = count_compilations()
    make_contact(bench)
    for fault in FAULTS.values():
        for _ in range(20):
            fault.step(bench)
        bench.step(60)
    bench.loop.hold(True)
    bench.step(5)
    assert {'float', 'hold', 'inflate'} <= set(bench.loop.events.reaction_counts)
    assert count_compilations() == before


def test_tare_needs_recent_readings_of_a_good_sensor_on_an_arm_at_rest():
    bench = Bench(sensor={'frozen_ticks': 5})

    def tare():
        return bench.loop.tare()

    bench.step(100)
    assert_allclose(tare(), 0.0, atol=0.02)
    speed = -0.03 * np.eye(6)[2]  # what slows the tool down would be taken for bias
    for k in range(100):
        bench.step(q=HOME + H * k * speed, qd=speed)
    bench.assert_refused('joint speeds: expected at most 0.02 rad/s', tare)
    bench.step(100)
    for _ in range(100):
        bench.step_half()
    bench.assert_refused('got stale', tare)
    bench.step(10)
    with pytest.raises(CalibrationError, match='expected at least 25 readings'):
        tare()
    bench.step(30, wrench=bench.wrench())
    bench.assert_refused('got frozen', tare)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'sensor': {'require_push_test': True}}, '~/push_test: pass it first'),
        (
            {'limits': {'workspace_lower': [-0.6, 0.2, 0.75]}},
            'has not begun .start_outside',
        ),
    ],
)
def test_commands_are_refused_before_control_begins(changes, message):
    bench = Bench(**changes)
    bench.step(10)
    bench.assert_refused(message)
    bench.step(10)
    assert not bench.loop.output.answer['active'].any()


def test_pull_of_a_surface_is_held_against_and_latched_until_a_retry():
    """As a sensor with the wrong sign reads a contact."""
    bench = Bench()
    bench.step(5)
    pull = np.array([0.0, 0.0, 12.0])
    bench.push[:3] = pull @ bench.state.sensor_pose.rotation_world
    bench.step(1200)
    assert bench.reaction == 'hold'
    bench.push = np.zeros(6)
    bench.step(100)
    assert bench.reaction == 'hold'
    assert bench.loop.status.causes == ('latched',)
    bench.loop.retry()
    bench.step(100)
    assert bench.reaction == 'none'


def test_stream_of_commands_does_not_seek_a_given_up_contact_again():
    bench = Bench()
    states = set()
    make_contact(bench)
    bench.press('table', 70.0)
    bench.step(5)
    bench.push = np.zeros(6)
    for k in range(150):
        bench.loop.set_forces({'table': 10.0 + 0.1 * (k % 5)})
        bench.step(10)
        states.add(bench.states['table'])
    assert states == {'retracting', 'given up'}


@BARE
def test_variances_are_bounded_alike_with_and_without_a_supervisor(supervised):
    bench = Bench(
        supervised=supervised, noise_variance={'smallest': 0.5, 'largest': 50.0}
    )
    used = bench.loop.supervisor.controller.contacts['noise_variance']

    def change(inputs):
        variance = VarianceInput(inputs.time, np.array([0.01, 1e4]))
        return inputs._replace(variance=variance)

    bench.step(3, change=change)
    assert used.tolist() == [0.5, 50.0]


@pytest.mark.parametrize(
    ('part', 'cause', 'reaction'),
    [
        ('task.update_wanted_task', 'law_ZeroDivisionError', 'hold'),
        ('inputs.validate', 'internal_ZeroDivisionError', 'float'),
    ],
)
def test_exception_is_told_in_words_and_logged_once_with_its_traceback(
    monkeypatch, caplog, part, cause, reaction
):
    bench = Bench()
    bench.step(5)
    owner, _, name = part.partition('.')
    owner = getattr(bench.loop.supervisor, owner)
    work = {'broken': True}
    right = getattr(owner, name)

    def broken(*given):
        if work.pop('broken', False) or name == 'update_wanted_task':
            raise ZeroDivisionError('the mass of nothing')
        return right(*given)

    monkeypatch.setattr(owner, name, broken)
    bench.step()
    assert bench.loop.status.causes == (cause,)
    assert bench.reaction == reaction
    bench.step(20)
    text = 'ZeroDivisionError: the mass of nothing'
    assert text in bench.loop.supervisor.findings
    (record,) = caplog.records
    assert record.getMessage() == f'{cause}: {text}'
    assert 'in broken' in caplog.text
    assert 'Traceback' in caplog.text


def test_law_that_has_no_answer_says_why_in_the_findings(caplog):
    # The tool is upright: the board's point lies straight above the table's.
    above = {'normal_world': [0.0, 0.0, -1.0], 'point_operational': [0.0, 0.0, 0.3]}
    bench = Bench(contacts={'board': above})
    bench.step()
    assert bench.loop.status.causes == ('law_ContactGeometryError',)
    assert bench.loop.supervisor.findings[0].startswith(
        'ContactGeometryError: N: expected independent columns, got normals and contact points'
    )
    (record,) = caplog.records
    assert 'expected independent columns' in record.getMessage()
    assert 'Traceback' not in caplog.text


def test_singular_arm_says_why_in_the_findings(monkeypatch):
    monkeypatch.setattr(
        'multicontact_control.control.controller.SINGULAR_MOBILITY', 0.0
    )
    bench = Bench(limits={'workspace_lower': [], 'workspace_upper': []})
    bench.step(q=np.zeros(6))
    assert 'law_SingularTaskError' in bench.loop.status.causes
    assert bench.loop.supervisor.findings[0].startswith(
        'SingularTaskError: J M^-1 J^T: expected a condition number below'
    )


def test_stale_wrench_is_explained_by_how_old_the_last_one_is():
    bench = Bench()
    bench.step(100)
    for _ in range(20):
        bench.step_half()
    assert 'wrench_stale' in bench.loop.status.causes
    (finding,) = bench.loop.supervisor.findings
    assert finding.startswith('The newest valid wrench is 26 ms old')
