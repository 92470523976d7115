"""What each message, or its absence, leads to: the rows of the table of `SampleTiming`."""

from multicontact_control.sampling import Action, SampleTiming
from multicontact_control.supervision.inputs import JointInput, WrenchInput
import numpy as np
import pytest
from waiting_simulator import Exchange

H = 0.002
PERIOD = 2_000_000
WAIT, STEP, ANEW, HALF, WITHOUT, REPEAT, SHOW, REFUSE = Action


def joints(stamp):
    return JointInput(stamp, np.full(2, float(stamp)), np.zeros(2))


def wrench(stamp):
    return WrenchInput(stamp, np.full(6, float(stamp)))


def timing_of(**options):
    return SampleTiming(1.0 / H, **options)


def sample(timing, stamp, now=0, **options):
    """Take in a whole sample, and return what to do."""
    timing.add_reading(joints(stamp))
    timing.add_reading(wrench(stamp))
    return timing.decide_on_message(now, **options)


def read(timing, reading):
    """Take in half of a sample, and return what to do."""
    timing.add_reading(reading)
    return timing.decide_on_message(0).action


def wait(timing):
    """Let time pass until a sample is missed, and return what to do."""
    return timing.decide_on_silence(timing.silence_deadline)


@pytest.mark.parametrize(('first', 'second'), [(joints, wrench), (wrench, joints)])
def test_pairing_gives_each_pair_once_in_either_order_and_never_mixes_stamps(
    first, second
):
    timing = timing_of()
    for stamp in (1, 2, 3):
        assert read(timing, first(stamp)) is WAIT
        timing.add_reading(second(stamp))
        action, inputs = timing.decide_on_message(0)
        assert action is STEP
        assert inputs.joints.q[0] == stamp
        assert inputs.wrench.wrench[0] == stamp
        assert timing.decide_on_message(0).action is WAIT
    assert timing.unpaired == 0


def test_readings_whose_other_half_does_not_come_are_counted():
    timing = timing_of()
    for reading in (joints(4), wrench(5), wrench(6)):
        assert read(timing, reading) is WAIT
    assert timing.stamp_difference == 2
    assert read(timing, joints(6)) is STEP
    assert timing.last_stamp == 6
    assert timing.unpaired == 2


@pytest.mark.parametrize('offset', [50_000, -50_000, 600_000, -900_000, 1_000_000])
def test_pairing_takes_sensors_that_are_read_at_another_time_of_the_period(offset):
    """Each pair once, at the stamp of the joints, and never with a reading a period away."""
    timing = timing_of(pair_tolerance=0.5)
    messages = {}
    for k in range(1, 8):
        messages[k * PERIOD] = joints
        messages[k * PERIOD + offset] = wrench
    for stamp, kind in sorted(messages.items()):
        timing.add_reading(kind(stamp))
        action, inputs = timing.decide_on_message(0)
        if action is STEP:
            assert abs(inputs.wrench.wrench[0] - timing.last_stamp) <= PERIOD // 2
    assert timing.tick == 6
    assert timing.last_stamp == 7 * PERIOD
    assert timing.unpaired == 0


def test_late_half_of_an_answered_sample_is_not_paired_with_the_next():
    timing = timing_of(pair_tolerance=0.5, patience=1.5)
    sample(timing, 0)
    timing.add_reading(joints(PERIOD))
    action, inputs = wait(timing)
    assert action is HALF
    assert (inputs.time, inputs.joints.stamp, inputs.wrench.stamp) == (H, H, 0.0)
    assert timing.silence_deadline == 2.5 * PERIOD  # on the grid of the samples
    assert read(timing, wrench(PERIOD + 50_000)) is WAIT
    assert wait(timing).action is WAIT
    assert read(timing, joints(2 * PERIOD)) is WAIT
    assert read(timing, wrench(2 * PERIOD + 50_000)) is STEP
    assert timing.last_stamp == 2 * PERIOD


def pass_periods(timing, periods):
    """Let a time pass since the first sample, and return what to do."""
    return timing.decide_on_silence(round(periods * PERIOD))


def test_sample_that_does_not_come_is_missed_a_period_late_and_then_every_period():
    timing = timing_of(patience=1.5)
    assert timing.silence_deadline == 0
    assert sample(timing, 0).inputs.time == 0.0
    assert pass_periods(timing, 1.4).action is WAIT
    assert pass_periods(timing, 1.5).action is WAIT
    for periods, ticks in ((2.5, 2), (3.5, 3)):
        action, inputs = pass_periods(timing, periods)
        assert action is WITHOUT
        assert inputs.time == pytest.approx(ticks * H)
        assert inputs.ahead == pytest.approx(inputs.time)
    assert timing.answered_stamp == 3 * PERIOD


def test_time_is_counted_on_and_does_not_go_back_when_late_samples_come():
    """Samples that are late by three periods, as those of a simulator that has slipped."""
    timing = timing_of(patience=1.5)
    sample(timing, 0)
    for periods in (1.5, 2.5, 3.5):
        pass_periods(timing, periods)
    for k in (1, 2, 3):
        late = sample(timing, k * PERIOD, (3 + k) * PERIOD)
        assert late.inputs.time == pytest.approx((3 + k) * H)
    for periods, ticks in (
        (56.9, 56),
        (57.5, 57),
    ):  # what was slept through counts once
        inputs = pass_periods(timing, periods).inputs
        assert inputs.time == pytest.approx(ticks * H)


def test_skipped_samples_are_counted_unless_the_clock_was_set_ahead():
    timing = timing_of()
    for stamp in (0, 4 * PERIOD, 1_800_000 * PERIOD):
        assert sample(timing, stamp).action is STEP
    assert timing.skipped == 3


def test_first_sample_after_a_restart_is_at_time_zero():
    timing = timing_of(patience=1.5)
    sample(timing, PERIOD)
    timing.restart()
    assert timing.silence_deadline == 0
    assert sample(timing, 2**31 * 10**9).inputs.time == 0.0


@pytest.mark.parametrize(
    'options',
    [
        {'patience': 0.0},
        {'patience': 1.5, 'supervised': False},
        {'patience': 1.5, 'lockstep': True},
    ],
)
def test_sample_is_waited_for_without_end_in_lockstep_and_without_supervisor(options):
    timing = timing_of(**options)
    assert sample(timing, 0).action is STEP
    assert timing.silence_deadline == 0
    assert timing.decide_on_silence(10**12).action is WAIT


@pytest.mark.parametrize('options', [{}, {'supervised': False}, {'lockstep': True}])
def test_repeated_sample_gets_its_command_again(options):
    timing = timing_of(**options)
    sample(timing, 100 * PERIOD)
    assert sample(timing, 100 * PERIOD).action is REPEAT


@pytest.mark.parametrize('options', [{'supervised': False}, {'lockstep': True}])
def test_older_sample_starts_anew_without_supervisor_and_in_lockstep(options):
    timing = timing_of(**options)
    sample(timing, 100 * PERIOD)
    action, inputs = sample(timing, PERIOD)
    assert action is ANEW
    assert inputs.time == 0.0
    assert timing.tick == 0


@pytest.mark.parametrize('options', [{'supervised': False}, {'lockstep': True}])
def test_samples_after_one_that_started_anew_follow_it(options):
    timing = timing_of(**options)
    sample(timing, 100 * PERIOD)
    sample(timing, PERIOD)
    assert sample(timing, PERIOD).action is REPEAT
    timing.add_noise_variance(PERIOD, np.ones(2))
    assert sample(timing, 2 * PERIOD).action is STEP


def test_older_sample_is_refused_by_a_supervisor_until_two_come_in_order():
    """It takes these for a clock that was set back."""
    timing = timing_of()
    sample(timing, 100 * PERIOD)
    for k, expected in ((90, REFUSE), (80, REFUSE), (103, STEP), (50, REFUSE)):
        assert sample(timing, k * PERIOD).action is expected
    action, inputs = sample(timing, 51 * PERIOD)
    assert action is STEP
    assert inputs.time == pytest.approx(-49 * H)


def test_lockstep_waits_for_the_variance_of_the_sample_before_but_not_in_the_safe_behaviour():
    timing = timing_of(lockstep=True)
    assert sample(timing, 0).action is STEP
    assert sample(timing, PERIOD).action is WAIT
    # The estimator has missed the last tick.
    assert sample(timing, PERIOD).action is SHOW
    timing.add_noise_variance(PERIOD, np.ones(2))  # of no sample so far
    assert timing.decide_on_message(0).action is WAIT
    assert timing.variance is None
    timing.add_noise_variance(0, np.ones(2))
    action, inputs = timing.decide_on_message(0)
    assert action is STEP
    assert inputs.variance.stamp == 0.0
    assert inputs.time == H
    assert sample(timing, 2 * PERIOD, safe=True).action is STEP


def test_bare_time_goes_in_whole_periods_and_joints_alone_are_a_sample_without_a_sensor():
    timing = timing_of(supervised=False, has_wrench=False)
    for k in range(4):
        late = 1000 * (k % 2)
        timing.add_reading(joints(k * PERIOD + late))
        action, inputs = timing.decide_on_message(0)
        assert action is STEP
        assert inputs.time == k * H
        assert inputs.wrench is None
        assert inputs.joints.stamp == pytest.approx(k * H + 1e-9 * late)


def test_other_half_of_a_sample_that_comes_again_is_no_older_sample():
    """A simulator sends both halves again, and waits for the stamp of its joints."""
    timing = timing_of(pair_tolerance=0.5, patience=1.5)
    sample(timing, 0)
    timing.add_reading(wrench(PERIOD + 50_000))
    assert wait(timing).action is HALF
    assert timing.decide_on_silence(5 * PERIOD).action is WITHOUT
    timing.add_reading(joints(PERIOD))
    timing.add_reading(wrench(PERIOD + 50_000))
    assert timing.decide_on_message(6 * PERIOD).action is REPEAT
    assert timing.answered_stamp == PERIOD


@pytest.mark.parametrize('apart', [0, 600_000])
@pytest.mark.parametrize(
    'options', [{'patience': 1.5}, {'patience': 0.0}, {'supervised': False}]
)
def test_simulator_that_waits_is_answered_whatever_is_lost_late_or_doubled(
    options, apart
):
    """100 stalls of 0.05 to 10 s, with messages lost, doubled and late before each."""
    for seed in range(10):
        random = np.random.default_rng(seed)
        exchange = Exchange(timing_of(pair_tolerance=0.5, **options), random, apart)
        for stall in np.exp(random.uniform(np.log(25), np.log(5000), 10)):
            exchange.set_share(0.1)
            exchange.run(50)
            exchange.run(round(stall), halted=True)
            exchange.set_share(0.0)
            assert exchange.goes_on(samples=20, within=400), (seed, stall)
