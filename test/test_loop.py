"""A control loop between activation and deactivation, with its supervisor, without middleware."""

from arms import HOME, pressed_wrench, still_config
from multicontact_control.control.tasks import MotionReading
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CalibrationError, CommandError, ConfigError
from multicontact_control.loop import ControlLoop
from multicontact_control.paths import config_dir
from multicontact_control.sampling import Action, SampleTiming
from multicontact_control.sensor.push_test import PushTestConfig
from multicontact_control.sensor.tool import TareConfig, weight_reading
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
import numpy as np
import pytest

PERIOD = 2_000_000
ORIGIN = 86_400 * 10 ** 9  # a clock that has nothing to do with ours
REST = np.zeros(6)
EFFORT = np.array([1.0, 29.0, 7.0, 0.5, 0.5, 0.1])


class Bench:
    """A loop with the timing before it, and an arm at home that feels what it is told to."""

    def __init__(self, *, supervised=True, **changes):
        self.config = still_config(**changes)
        self.loop = ControlLoop(
            self.config, None, CommandLimits(), config_dir(), supervised=supervised)
        self.timing = SampleTiming(
            self.config.rate, supervised=supervised, patience=1.5,
            feels=self.config.wrench_input != 'momentum')
        self.state = RobotModel(self.config.robot, config_dir()).update(HOME, np.zeros(6))
        self.weight = weight_reading(
            self.state.sensor_pose.rotation_world, self.config.tool,
            np.array(self.config.robot.gravity_world))
        self.random = np.random.default_rng(0)
        self.k = 0
        self.push = np.zeros(6)

    @property
    def stamp(self):
        return ORIGIN + self.k * PERIOD

    def wrench(self):
        return self.weight + self.push + 0.02 * self.random.standard_normal(6)

    def step(self, n=1, effort=EFFORT, wrench=None, q=HOME, qd=REST):
        for _ in range(n):
            self.timing.add(JointInput(self.stamp, q.copy(), qd, effort))
            self.timing.add(WrenchInput(
                self.stamp, self.wrench() if wrench is None else wrench))
            action, inputs = self.timing.what_now(self.stamp)
            assert action is Action.STEP
            torque = self.loop.step(inputs)
            self.timing.add_variance(self.stamp, np.full(2, 0.6))
            self.k += 1
        return torque

    def step_half(self, q=HOME, *, joints=True):
        if joints:
            self.timing.add(JointInput(self.stamp, q.copy(), REST))
        else:
            self.timing.add(WrenchInput(self.stamp, self.wrench()))
        action, inputs = self.timing.late(self.timing.due)
        assert action is Action.HALF
        self.k += 1
        return self.loop.step(inputs)

    def step_without(self):
        """Let time pass until there is a tick without a sample."""
        action = Action.WAIT
        while action is Action.WAIT:
            action, inputs = self.timing.late(self.timing.due)
        assert action is Action.WITHOUT
        return self.loop.step(inputs)

    def restart(self):
        self.loop.restart()
        self.timing.restart()

    def press(self, name, force):
        """Let the sensor feel a contact force, as if it acted at the sensor's origin."""
        self.push = pressed_wrench(self.config, self.state, **{name: force})

    @property
    def reaction(self):
        return self.loop.status.reaction

    @property
    def states(self):
        return dict(zip(self.config.contact_names, self.loop.status.contact_states))


def make_contact(bench, force=6.0):
    bench.step(5)
    bench.loop.set_forces({'table': force})
    bench.step(2)
    assert bench.states['table'] == 'approaching'
    bench.press('table', force)
    bench.step(60)
    assert bench.states['table'] == 'holding'
    assert bench.loop.output.alpha_des[0] == pytest.approx(force)


def test_commanded_force_is_sought_held_given_back_and_forgotten_at_a_restart():
    bench = Bench()
    make_contact(bench)
    bench.loop.set_forces({'table': 0.0})
    bench.step(2)
    assert bench.states['table'] == 'free'
    assert not bench.loop.output.alpha_des.any()
    bench.push = np.zeros(6)
    make_contact(bench)
    bench.push = np.zeros(6)
    bench.restart()

    np.testing.assert_array_equal(bench.step(effort=-EFFORT), -EFFORT)
    assert bench.states['table'] == 'free'


def test_reconfigure_repeats_the_last_command_and_a_refusal_changes_nothing():
    bench = Bench()
    make_contact(bench)
    before = bench.step()
    config = still_config(force={'time_constant': 0.05}, motion={'natural_frequency': 15.0})
    bench.loop.supervisor.reconfigure(config)
    assert bench.loop.config is config
    after = [bench.step() for _ in range(200)]
    np.testing.assert_array_equal(after[0], before)
    assert bench.states['table'] == 'holding'
    for changes in ({'limits': {'operational_speed': 0.1}}, {'watchdog': {'rate_band': 3.0}},
                    {'contact_state': {'preload': 1.0}}, {'rate': 400.0}):
        with pytest.raises(ConfigError, match=f'^{next(iter(changes))}: expected .* while in use'):
            bench.loop.supervisor.reconfigure(still_config(**changes))
        assert bench.loop.config is config


def test_hold_keeps_pose_and_force_and_go_on_has_no_jump():
    bench = Bench()
    make_contact(bench)
    bench.loop.set_forces({'board': 4.0})  # sought, never found
    bench.step(30)
    before = bench.step()
    bench.loop.hold(True)
    np.testing.assert_array_equal(bench.step(), before)
    bench.step(300)
    desired = bench.loop.output.pose_des.position_world
    assert bench.states == {'table': 'holding', 'board': 'free'}
    assert bench.loop.output.alpha_des == pytest.approx([6.0, 0.0])
    np.testing.assert_allclose(desired, bench.state.pose.position_world, atol=1e-9)
    with pytest.raises(CommandError, match='~/hold: expected released'):
        bench.loop.set_forces({'table': 1.0})
    before = bench.step()
    bench.loop.hold(False)
    np.testing.assert_array_equal(bench.step(), before)
    bench.step(100)
    assert bench.states == {'table': 'holding', 'board': 'approaching'}


def test_motion_has_no_effect_along_a_contact_that_is_sought_or_held():
    bench = Bench()
    make_contact(bench)
    before = bench.loop.output.pose_des.position_world
    wanted = bench.state.pose.position_world + [0.004, 0.002, 0.05]
    bench.loop.set_motion(MotionReading(
        wanted, bench.state.pose.quaternion_xyzw, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        np.zeros(6)))
    bench.step()
    np.testing.assert_allclose(
        bench.loop.output.pose_des.position_world - before, [0.004, 0.002, 0.0], atol=1e-9)


@pytest.mark.parametrize(('half', 'reaction', 'bridged'), [
    ('joints', 'hold', 12), ('wrench', 'float', 1), ('none', 'float', 0)])
def test_missing_half_is_bridged_and_reacted_to_and_recovery_has_no_jump(half, reaction, bridged):
    """Wrenches alone leave the arm unseen; joints alone let it be held."""
    bench = Bench()
    make_contact(bench)
    torques, reactions = [bench.step()], []
    for _ in range(bridged + 29):
        if half == 'none':
            torques.append(bench.step_without())
        else:
            torques.append(bench.step_half(joints=half == 'joints'))
        reactions.append(bench.reaction)
    assert {*reactions[:bridged]} <= {'none', 'inflate'}
    assert reactions[bridged:] == [reaction] * 29
    torques += [bench.step() for _ in range(100)]
    assert bench.reaction == 'none'
    limit = np.array(bench.config.torque_limit)
    assert (np.abs(np.diff(torques, axis=0)) / limit).max() < 0.03


def test_gaps_and_jumps_of_the_clock_are_got_over():
    bench = Bench()
    bench.step(10)
    for _ in range(4):  # as a simulator that stands still: its stamps go on
        bench.step_without()
    bench.step(60)
    assert bench.reaction == 'none'
    assert not any('clock' in what for _, what in bench.loop.events.events)
    bench = Bench()
    bench.step(50)
    bench.k -= 40
    with pytest.raises(AssertionError, match='REFUSE'):  # one alone is only late
        bench.step()
    bench.k += 1
    bench.step()
    assert bench.loop.status.causes == ('clock_backwards',)
    assert bench.reaction == 'hold'
    bench.step(60)
    assert bench.reaction == 'none'


def test_task_time_follows_the_stamps_over_skipped_samples():
    """A clock that is set ahead by an hour makes none."""
    bench = Bench()
    bench.step(10)
    bench.k += 4
    bench.step(2)
    assert bench.loop.status.task_time == pytest.approx(0.002 * 16)
    for ahead, skipped in ((2500, 2504), (1_800_000, 2504)):
        bench.k += ahead
        bench.step(2)
        assert bench.timing.skipped == skipped


@pytest.mark.parametrize('changes', [
    {}, {'sensor': {'filter_order': 2, 'filter_cutoff': 20.0, 'frozen_ticks': 5}}])
@pytest.mark.parametrize('fault', ['saturated', 'frozen'])
def test_fault_of_the_sensor_holds_the_arm(fault, changes):
    """Also behind a low-pass, in which a frozen reading takes its time to settle."""
    bench = Bench(**changes)
    bench.step(60)
    assert bench.reaction == 'none'
    reading = bench.wrench()
    for _ in range(9):
        bench.step(wrench=reading if fault == 'frozen' else (
            bench.wrench() + [0.0, 0.0, 220.0, 0.0, 0.0, 0.0]))
    assert f'wrench_{fault}' in bench.loop.status.causes and bench.reaction == 'hold'
    assert bench.loop.supervisor.inputs.sensor_fault == fault


def test_bias_of_the_sensor_is_not_taken_for_a_sideways_force():
    bias = [20.0, -15.0, 9.0, 0.1, 0.0, 0.2]
    bench = Bench(tool={'bias_sensor': bias})
    bench.push = np.array(bias)
    bench.step(30)
    assert bench.reaction == 'none'


def test_tare_needs_readings_of_now_of_a_good_sensor_on_an_arm_at_rest():
    bench = Bench(sensor={'frozen_ticks': 5})

    def assert_refused(match, error=CommandError):
        with pytest.raises(error, match=match):
            bench.loop.tare(TareConfig())

    bench.step(100)
    np.testing.assert_allclose(bench.loop.tare(TareConfig()), 0.0, atol=0.02)
    speed = -0.03 * np.eye(6)[2]  # what slows the tool down would be taken for bias
    for k in range(100):
        bench.step(q=HOME + 0.002 * k * speed, qd=speed)
    assert_refused('joint speeds: expected at most 0.02 rad/s')
    bench.step(100)
    [bench.step_half() for _ in range(100)]  # what was felt before may not be there any more
    assert_refused('expected at least 25 readings, found 0', CalibrationError)
    bench.step(10)
    assert_refused('expected at least 25 readings, found 10', CalibrationError)
    bench.step(30, wrench=bench.wrench())
    assert_refused('found frozen')


def tare_and_push_test(bench):
    return (lambda: bench.loop.tare(TareConfig()),
            lambda: bench.loop.push_test(PushTestConfig(), ()))


def test_what_needs_a_wrist_sensor_is_refused_without_one():
    """A push test that nothing ends would lock the arm for good."""
    bench = Bench(wrench_input='momentum', robot={'sensor_frame': ''})
    bench.step(30)
    for action in tare_and_push_test(bench):
        with pytest.raises(CommandError, match='wrench_input: expected raw or filtered, for a'):
            action()
    bench.loop.set_forces({'table': 5.0})


def test_force_that_a_reaction_keeps_is_not_taken_for_bias():
    """While the arm is held it presses on; later, without a contact, both are possible."""
    bench = Bench(watchdog={'friction_bound': 0.2})
    make_contact(bench, 10.0)
    contact = bench.push.copy()
    table, board = (each.normal_world for each in bench.config.contacts.values())
    sideways = np.zeros(6)
    sideways[:3] = 20.0 * np.cross(table, board) @ bench.state.sensor_pose.rotation_world
    bench.push = contact + sideways
    bench.step(50)
    assert bench.reaction == 'hold' and not bench.loop.output.active.any()
    for action in tare_and_push_test(bench):
        with pytest.raises(CommandError, match='contacts: expected none pressed by a reaction'):
            action()
    bench.push = sideways
    bench.step(200)
    assert bench.reaction == 'hold'
    np.testing.assert_allclose(bench.loop.tare(TareConfig())[:3], sideways[:3], atol=0.1)


def test_reaction_that_presses_ends_in_a_hold_and_in_the_safe_behaviour():
    bench = Bench()
    make_contact(bench)
    [bench.step_half() for _ in range(40)]
    assert bench.reaction == 'hold' and bench.loop.supervisor.reactions.presses
    bench.loop.hold(True)
    bench.step(200)
    assert (bench.reaction, bench.loop.held) == ('none', True)
    assert bench.states == {'table': 'holding', 'board': 'free'}
    np.testing.assert_allclose(bench.loop.output.alpha_des, [6.0, 0.0])
    [bench.step_half() for _ in range(40)]
    assert bench.loop.supervisor.reactions.presses
    bench.loop.stop()
    bench.push = np.zeros(6)
    bench.step(120)
    assert not bench.loop.supervisor.reactions.presses
    assert bench.states == {'table': 'free', 'board': 'free'}
    np.testing.assert_allclose(bench.loop.tare(TareConfig()), 0.0, atol=0.02)


@pytest.mark.parametrize('nothing', [None, np.zeros(6), np.full(6, np.nan)])
def test_arm_without_a_sensor_is_held_where_its_torques_are_not_told_any_more(nothing):
    """What the momentum observer said last must not pass for what is measured."""
    bench = Bench(wrench_input='momentum', robot={'sensor_frame': ''})

    def be(ticks):
        for _ in range(ticks):
            bench.step(effort=bench.state.gravity + 0.01 * bench.random.standard_normal(6))

    be(60)
    assert bench.reaction == 'none'
    bench.step(40, effort=nothing)
    assert bench.loop.status.causes == ('wrench_stale',)
    be(200)
    assert bench.reaction == 'none'


def raw_inputs(bench, wrench, stamp=None):
    now = bench.k * bench.config.period
    bench.k += 1
    return TickInputs(now, JointInput(now, HOME.copy(), REST, EFFORT), WrenchInput(
        now if stamp is None else stamp, wrench), VarianceInput(now, np.full(2, 0.6)))


def test_a_reading_passes_the_low_pass_once_however_often_it_is_the_newest():
    bench = Bench(sensor={'filter_order': 1, 'filter_cutoff': 20.0})
    bench.loop.step(raw_inputs(bench, bench.weight))
    bench.press('table', 10.0)
    forces = []
    for stamp in (None, 0.002, None):
        bench.loop.step(raw_inputs(bench, bench.weight + bench.push, stamp))
        forces.append(bench.loop.output.alpha_meas[0])
    assert 0.5 < forces[0] == forces[1] < forces[2] < 5.0


def test_without_supervisor_a_sample_must_be_complete():
    bench = Bench(supervised=False)
    bench.step(2)
    with pytest.raises(CommandError, match='supervised: expected true'):
        bench.loop.step(TickInputs(0.004))


@pytest.mark.parametrize('supervised', [True, False])
def test_without_push_test_no_force_is_controlled_and_the_arm_holds(supervised):
    bench = Bench(supervised=supervised, sensor={'require_push_test': True})
    bench.step(10)
    for command in (lambda: bench.loop.set_forces({'table': 1.0}),
                    lambda: bench.loop.hold(True)):
        with pytest.raises(CommandError, match='~/push_test: expected passed'):
            command()
    bench.step(10)
    assert not bench.loop.output.active.any()
    np.testing.assert_allclose(bench.loop.output.pose_des.position_world,
                               bench.state.pose.position_world, atol=1e-12)


def test_nothing_is_held_or_commanded_before_control_has_begun():
    """It was taken for done, and forgotten when control began."""
    bench = Bench(limits={'workspace_lower': [-0.6, 0.2, 0.75]})
    bench.step(10)
    assert bench.loop.status.causes == ('start_outside',)
    for command in (lambda: bench.loop.hold(True), lambda: bench.loop.set_forces({'table': 5.0})):
        with pytest.raises(CommandError, match='control: expected begun, .*found start_outside'):
            command()


def test_hold_while_a_reaction_lets_the_arm_be_moved_stays_where_it_is_now():
    bench = Bench(watchdog={'on_wrench_fault': 'damp'})
    bench.step(30)
    [bench.step_half() for _ in range(40)]
    assert bench.reaction == 'damp'
    q = HOME.copy()
    for _ in range(100):
        q[4] += 0.002
        bench.step_half(q)
    bench.loop.hold(True)
    bench.step(200, q=q)
    assert bench.reaction == 'none' and bench.loop.held
    output = bench.loop.output
    np.testing.assert_allclose(
        output.pose_des.position_world, output.pose.position_world, atol=1e-6)


def test_stream_of_commands_does_not_seek_a_contact_again_that_was_left():
    """A command after a while does."""
    bench = Bench()
    make_contact(bench, 10.0)
    bench.press('table', 70.0)
    bench.step(5)
    bench.push = np.zeros(6)
    seen = set()
    for k in range(1500):
        if k % 10 == 0:
            bench.loop.set_forces({'table': 10.0 + 0.1 * (k // 10 % 5)})
        bench.step()
        seen.add(bench.states['table'])
    assert seen == {'retracting', 'given up'}
    bench.step(600)
    bench.loop.set_forces({'table': 12.0})
    bench.step(5)
    assert bench.states['table'] == 'approaching'
