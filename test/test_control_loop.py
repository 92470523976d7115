"""A control loop between activation and deactivation, with its supervisor, without middleware."""

from __future__ import annotations

from arms import HOME, still_config
from multicontact_control.config import ControllerConfig
from multicontact_control.control_loop import ControlLoop
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CalibrationError, CommandError, ConfigError
from multicontact_control.paths import config_dir
from multicontact_control.sampling import (
    JointReading,
    MotionReading,
    PairedSample,
    WrenchReading,
)
from multicontact_control.sensor.push_config import PushTestConfig
from multicontact_control.sensor.tare import TareConfig
from multicontact_control.sensor.weight import weight_reading
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
EFFORT = np.array([1.0, 29.0, 7.0, 0.5, 0.5, 0.1])


class Bench:
    """A loop, and an arm at home that feels what it is told to."""

    def __init__(self, *, supervised=True, **changes):
        self.config: ControllerConfig = still_config(**changes)
        self.loop = ControlLoop(
            self.config, None, CommandLimits(), config_dir(), supervised=supervised)
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

    def step(self, n=1, effort=EFFORT):
        for _ in range(n):
            torque = self.loop.step(PairedSample(
                self.stamp, HOME.copy(), np.zeros(6), self.wrench(), effort))
            self.loop.take_variance(self.stamp, np.full(2, 0.6))
            self.k += 1
        return torque

    def press(self, name, force):
        """Let the sensor feel a contact force, as if it acted at the sensor's origin."""
        contact, sensor = self.config.contacts[name], self.state.sensor_pose
        point = self.state.pose.position_world + self.state.pose.rotation_world @ (
            np.array(contact.point_operational))
        world = force * np.array(contact.normal_world)
        moment = np.cross(point - sensor.position_world, world)
        R = sensor.rotation_world
        self.push = np.concatenate([world @ R, moment @ R])

    @property
    def reaction(self):
        return self.loop.status.reaction

    @property
    def states(self):
        return dict(zip(self.config.contact_names, self.loop.status.contact_states))


def test_first_command_is_what_acts_and_the_law_is_blended_in_at_the_declared_rate():
    bench = Bench(transition={'torque_rate': 50.0, 'blend_time': 0.0})
    torques = [bench.step() for _ in range(1500)]
    np.testing.assert_array_equal(torques[0], EFFORT)
    assert np.abs(np.diff(torques, axis=0)).max() <= 50.0 * 0.002 * 1.02  # and the law's own
    np.testing.assert_allclose(torques[-1], bench.state.gravity, atol=0.5)


def test_restart_begins_anew():
    bench = Bench()
    bench.step(20)
    bench.loop.set_forces({'table': 5.0})
    bench.step(5)
    bench.loop.restart()
    np.testing.assert_array_equal(bench.step(effort=-EFFORT), -EFFORT)
    assert bench.states == {'table': 'free', 'board': 'free'}
    assert bench.loop.tick == 0


def make_contact(bench, force=6.0):
    bench.step(5)
    bench.loop.set_forces({'table': force})
    bench.step(2)
    assert bench.states['table'] == 'approaching'
    bench.press('table', force)
    bench.step(60)
    assert bench.states['table'] == 'holding'
    assert bench.loop.output.alpha_des[0] == pytest.approx(force)


def test_commanded_force_is_sought_held_and_given_back():
    bench = Bench()
    make_contact(bench)
    bench.loop.set_forces({'table': 0.0})
    bench.step(2)
    assert bench.states['table'] == 'free'
    assert not bench.loop.output.alpha_des.any()


def test_reconfigure_repeats_the_last_command_and_a_refusal_changes_nothing():
    bench = Bench()
    make_contact(bench)
    before = bench.step()
    config = still_config(force={'time_constant': 0.05}, motion={'natural_frequency': 15.0})
    bench.loop.controller.reconfigure(config)
    assert bench.loop.config is config
    after = [bench.step() for _ in range(200)]
    np.testing.assert_array_equal(after[0], before)
    assert bench.states['table'] == 'holding'
    for changes in ({'limits': {'operational_speed': 0.1}}, {'watchdog': {'rate_band': 3.0}},
                    {'contact_state': {'preload': 1.0}}, {'rate': 400.0}):
        with pytest.raises(ConfigError, match=f'^{next(iter(changes))}: expected .* while in use'):
            bench.loop.controller.reconfigure(still_config(**changes))
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


def test_position_outside_the_box_is_refused():
    bench = Bench()
    bench.step(2)
    with pytest.raises(CommandError, match='position x: expected -0.6 to 0.6 m, found 2 m'):
        bench.loop.set_motion(MotionReading(
            np.array([2.0, 0.5, 0.5]), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(6), np.zeros(6)))


@pytest.mark.parametrize('kind', ['gravity_compensation', 'zero_torque', 'hold_position'])
def test_deactivation_reaches_the_safe_behaviour_without_a_jump(kind):
    bench = Bench(safe_behaviour={'kind': kind})
    make_contact(bench)
    before = bench.step()
    bench.loop.safe = True
    torques = [before, *(bench.step() for _ in range(2500))]
    np.testing.assert_array_equal(torques[1], before)
    assert np.abs(np.diff(torques, axis=0)).max() <= 100.0 * 0.002 * 1.001
    expected = 0.0 * EFFORT if kind == 'zero_torque' else bench.state.gravity
    np.testing.assert_allclose(torques[-1], expected, atol=1e-6)
    assert bench.loop.output is None


def test_missing_samples_get_the_declared_reaction_and_recovery_has_no_jump():
    bench = Bench()
    make_contact(bench)
    torques = [bench.step()]
    torques.append(bench.loop.step_without(2))
    assert bench.reaction == 'float'
    torques += [bench.loop.step_without(1) for _ in range(50)]
    assert bench.reaction == 'float'
    for _ in range(100):
        torques.append(bench.step())
    assert bench.reaction == 'none'
    limit = np.array(bench.config.torque_limit)
    assert (np.abs(np.diff(torques, axis=0)) / limit).max() < 0.03


@pytest.mark.parametrize(('half', 'reaction', 'bridged'), [
    ('joints', 'hold', 12), ('wrench', 'float', 1)])
def test_one_half_alone_is_bridged_and_then_reacted_to(half, reaction, bridged):
    """Wrenches alone leave the arm unseen; joints alone let it be held."""
    bench = Bench()
    make_contact(bench)
    reactions = []
    for _ in range(bridged + 9):
        bench.loop.step_half(
            JointReading(bench.stamp, HOME.copy(), np.zeros(6)) if half == 'joints'
            else WrenchReading(bench.stamp, bench.wrench()))
        bench.k += 1
        reactions.append(bench.reaction)
    assert {*reactions[:bridged]} <= {'none', 'inflate'}
    assert reactions[bridged:] == [reaction] * 9


def test_late_samples_after_a_gap_are_taken_and_time_goes_on():
    """As from a simulator that has stood still: stamps go on where they were."""
    bench = Bench()
    bench.step(10)
    for periods in (2, 1, 1, 1):
        bench.loop.step_without(periods)
    bench.step(60)
    assert bench.reaction == 'none'
    assert not any('clock' in what for _, what in bench.loop.events.events)


def test_clock_that_is_set_back_calls_for_its_reaction_and_is_got_over():
    bench = Bench()
    bench.step(50)
    bench.k -= 40
    bench.step()
    assert bench.loop.status.causes == ('clock_backwards',)
    assert bench.reaction == bench.config.watchdog.on_clock_fault
    bench.step(60)
    assert bench.reaction == 'none'


def test_task_time_follows_the_stamps_over_skipped_samples():
    bench = Bench()
    bench.step(10)
    bench.k += 4
    bench.step(2)
    assert bench.loop.status.task_time == pytest.approx(0.002 * 16)
    assert bench.loop.skipped == 4


def test_clock_that_is_set_ahead_makes_no_missed_samples():
    bench = Bench()
    bench.step(10)
    bench.k += 2500  # 5 s without a sample are some
    bench.step(2)
    assert bench.loop.skipped == 2500
    bench.k += 1_800_000
    bench.step(2)
    assert bench.loop.skipped == 2500


@pytest.mark.parametrize('fault', ['saturated', 'frozen'])
def test_what_the_sensors_monitor_finds_reaches_the_watchdog(fault):
    """By the front end's own limits; those of the watchdog are switched off."""
    bench = Bench(watchdog={'wrench_full_scale': [], 'frozen_samples': 0})
    bench.step(20)
    frozen = bench.wrench()
    for _ in range(10):
        wrench = frozen.copy() if fault == 'frozen' else bench.wrench() + [150.0, 0, 0, 0, 0, 0]
        bench.loop.step(PairedSample(bench.stamp, HOME.copy(), np.zeros(6), wrench))
        bench.k += 1
    assert bench.loop.sensor_fault == fault
    assert f'wrench_{fault}' in bench.loop.status.causes
    assert bench.reaction == 'hold'
    assert bench.loop.rejected[f'wrench_{fault}'] >= 5


@pytest.mark.parametrize('fault', ['saturated', 'frozen'])
def test_low_pass_does_not_hide_from_the_watchdog_what_is_wrong_with_a_sensor(fault):
    """Behind 20 Hz a frozen reading settles, bit by bit, for a third of a second."""
    bench = Bench(sensor={'filter_order': 2, 'filter_cutoff': 20.0}, watchdog={
        'frozen_samples': 5, 'wrench_full_scale': [100.0] * 6})
    bench.step(60)
    assert bench.reaction == 'none'
    reading = bench.wrench()
    for _ in range(9):
        bench.loop.step(PairedSample(
            bench.stamp, HOME.copy(), np.zeros(6),
            bench.wrench() + [0.0, 0.0, 200.0, 0.0, 0.0, 0.0] if fault == 'saturated'
            else reading, EFFORT))
        bench.k += 1
    assert f'wrench_{fault}' in bench.loop.status.causes and bench.reaction == 'hold'


def test_bias_of_the_sensor_is_not_taken_for_a_sideways_force():
    bias = [20.0, -15.0, 9.0, 0.1, 0.0, 0.2]
    bench = Bench(tool={'bias_sensor': bias})
    bench.push = np.array(bias)
    bench.step(30)
    assert bench.reaction == 'none'


def test_tare_waits_for_an_arm_that_stands_still():
    """What slows the tool down would be taken for bias."""
    bench = Bench()
    bench.step(100)
    speed = np.array([0.0, 0.0, -0.03, 0.0, 0.0, 0.0])
    for k in range(100):
        bench.loop.step(PairedSample(
            bench.stamp, HOME + 0.002 * k * speed, speed, bench.wrench(), EFFORT))
        bench.k += 1
    with pytest.raises(CommandError, match='joint speeds: expected at most 0.02 rad/s for a tare'
                       ', found 0.03 rad/s'):
        bench.loop.tare(TareConfig())
    bench.step(100)
    np.testing.assert_allclose(bench.loop.tare(TareConfig()), 0.0, atol=0.02)


def test_tare_without_a_reading_is_refused():
    bench = Bench()
    bench.step(2)
    bench.loop.restart()
    bench.loop.step_half(JointReading(bench.stamp, HOME.copy(), np.zeros(6)))
    with pytest.raises(CalibrationError, match='expected at least 25 readings, found 0'):
        bench.loop.tare(TareConfig())


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
    bench = Bench(watchdog={'friction_bound': 0.2, 'friction_offset': 5.0})
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


def test_safe_behaviour_forgets_what_a_reaction_pressed_with():
    bench = Bench()
    make_contact(bench, 10.0)
    for _ in range(40):
        bench.loop.step_half(JointReading(bench.stamp, HOME.copy(), np.zeros(6)))
        bench.k += 1
    assert bench.loop.supervisor.presses
    bench.loop.stop()
    bench.push = np.zeros(6)
    bench.step(120)
    assert not bench.loop.supervisor.presses
    assert bench.states == {'table': 'free', 'board': 'free'}
    np.testing.assert_allclose(bench.loop.tare(TareConfig()), 0.0, atol=0.02)


def test_hold_while_the_arm_is_held_by_a_reaction_keeps_what_is_pressed():
    bench = Bench()
    make_contact(bench)
    for _ in range(40):
        bench.loop.step_half(JointReading(bench.stamp, HOME.copy(), np.zeros(6)))
        bench.k += 1
    assert bench.reaction == 'hold'
    bench.loop.hold(True)
    bench.step(200)
    assert (bench.reaction, bench.loop.held) == ('none', True)
    assert bench.states == {'table': 'holding', 'board': 'free'}
    np.testing.assert_allclose(bench.loop.output.alpha_des, [6.0, 0.0])


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


def test_sensor_that_is_known_to_be_wrong_is_not_tared():
    bench = Bench(sensor={'frozen_ticks': 5})
    bench.step(120)
    reading = bench.wrench()
    for _ in range(30):
        bench.loop.step(PairedSample(bench.stamp, HOME.copy(), np.zeros(6), reading, EFFORT))
        bench.k += 1
    with pytest.raises(CommandError, match='wrench: expected nothing wrong with it, for a tare, '
                       'found frozen'):
        bench.loop.tare(TareConfig())


def raw_inputs(bench, wrench, stamp=None):
    """Return what is known at the bench's tick, with any reading for a wrench."""
    now = bench.k * bench.config.period
    bench.k += 1
    return TickInputs(now, JointInput(now, HOME.copy(), np.zeros(6), effort=EFFORT),
                      WrenchInput(now if stamp is None else stamp, wrench),
                      VarianceInput(now, np.full(2, 0.6)))


def test_a_reading_passes_the_low_pass_once_however_often_it_is_the_newest():
    """A step of 10 N: what is only shown again does not bring the filter on."""
    bench = Bench(sensor={'filter_order': 1, 'filter_cutoff': 20.0})
    bench.loop.answer(raw_inputs(bench, bench.weight))
    bench.press('table', 10.0)
    forces = []
    for stamp in (None, 0.002, None):
        bench.loop.answer(raw_inputs(bench, bench.weight + bench.push, stamp))
        forces.append(bench.loop.output.alpha_meas[0])
    assert 0.5 < forces[0] == forces[1] < forces[2] < 5.0


@pytest.mark.parametrize('wrench', [
    np.zeros(5), None, 'nothing', np.full(6, np.nan), np.full((2, 3), 1.0)])
def test_wrench_that_is_none_is_refused_and_does_not_stay_in_the_low_pass(wrench):
    bench = Bench(sensor={'filter_order': 2, 'filter_cutoff': 50.0})
    bench.step(60)
    for _ in range(13):  # one more than the observers predict
        bench.loop.answer(raw_inputs(bench, wrench))
    assert bench.reaction == 'hold'
    # By then a NaN that stays has been seen to be frozen, too.
    assert bench.loop.status.causes in (('wrench_invalid',), ('wrench_frozen',))
    for _ in range(40):
        bench.loop.answer(raw_inputs(bench, bench.wrench()))
    assert bench.reaction == 'none'
    assert abs(bench.loop.output.alpha_meas[0]) < 0.5


def test_without_supervisor_a_sample_must_be_complete():
    bench = Bench(supervised=False)
    bench.step(2)
    for step in (lambda: bench.loop.step_without(1),
                 lambda: bench.loop.step_half(WrenchReading(bench.stamp, bench.wrench())),
                 lambda: bench.loop.answer(TickInputs(0.004))):
        with pytest.raises(CommandError, match='supervised: expected true'):
            step()


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


def without_wrench(bench, ticks, q=HOME):
    for _ in range(ticks):
        bench.loop.step_half(JointReading(bench.stamp, q.copy(), np.zeros(6)))
        bench.k += 1


def test_tare_needs_readings_of_now():
    """What was read before the sensor went silent may hold a force that is not there any more."""
    bench = Bench()
    bench.step(120)
    without_wrench(bench, 100)
    with pytest.raises(CommandError, match='wrench: expected a new one, for a tare, found one of '
                       '0.2 s ago'):
        bench.loop.tare(TareConfig())
    bench.step(10)
    with pytest.raises(CalibrationError, match='expected at least 25 readings, found 10'):
        bench.loop.tare(TareConfig())
    bench.step(90)
    np.testing.assert_allclose(bench.loop.tare(TareConfig()), 0.0, atol=0.02)


def test_hold_while_a_reaction_lets_the_arm_be_moved_stays_where_it_is_now():
    bench = Bench(watchdog={'on_wrench_fault': 'damp'})
    bench.step(30)
    without_wrench(bench, 40)
    assert bench.reaction == 'damp'
    q = HOME.copy()
    for _ in range(100):
        q[4] += 0.002
        without_wrench(bench, 1, q)
    bench.loop.hold(True)
    place = RobotModel(bench.config.robot, config_dir()).update(q, np.zeros(6)).pose
    for _ in range(200):
        bench.loop.step(PairedSample(bench.stamp, q.copy(), np.zeros(6), bench.wrench(), EFFORT))
        bench.k += 1
    assert bench.reaction in ('none', 'inflate') and bench.loop.held  # no R is told of
    np.testing.assert_allclose(
        bench.loop.output.pose_des.position_world, place.position_world, atol=1e-6)


def test_stream_of_commands_does_not_seek_a_contact_again_that_was_left():
    """Nor does it resume control that waits for somebody: a command after a while does."""
    bench = Bench()
    make_contact(bench, 10.0)
    bench.press('table', 70.0)
    bench.step(5)
    bench.push = np.zeros(6)

    def stream(ticks, start):
        seen = set()
        for k in range(ticks):
            if k % 10 == 0:
                bench.loop.set_forces({'table': 10.0 + 0.1 * (k // 10 % 5) + start})
            bench.step()
            seen.add(bench.states['table'])
        return seen

    assert stream(1500, 0.0) == {'retracting', 'given up'}
    bench.step(600)
    bench.loop.set_forces({'table': 12.0})
    bench.step(5)
    assert bench.states['table'] == 'approaching'


def test_push_test_that_is_passed_does_not_end_a_hold():
    bench = Bench()
    bench.step(120)
    bench.loop.hold(True)
    bench.loop.push_test(PushTestConfig(), ())
    bench.step(10)
    bench.loop._reference.unlock()
    assert bench.loop.held
    bench.loop.hold(False)
    bench.step(10)
    assert not bench.loop.held
