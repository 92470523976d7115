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


@pytest.mark.parametrize('joints_first', [True, False])
def test_pairing_gives_each_pair_once_in_either_order_and_never_mixes_stamps(
    joints_first,
):
    timing = timing_of()
    for stamp in (1, 2, 3):
        first, second = (joints, wrench) if joints_first else (wrench, joints)
        timing.add_reading(first(stamp))
        assert timing.decide_on_message(0).action is WAIT
        timing.add_reading(second(stamp))
        action, inputs = timing.decide_on_message(0)
        assert action is STEP and timing.decide_on_message(0).action is WAIT
        assert (inputs.joints.q[0], inputs.wrench.wrench[0]) == (stamp, stamp)
    assert timing.unpaired == 0
    for reading in (joints(4), wrench(5), wrench(6)):
        timing.add_reading(reading)
        assert timing.decide_on_message(0).action is WAIT
    assert timing.stamp_difference == 2
    timing.add_reading(joints(6))
    assert timing.decide_on_message(0).action is STEP and timing.last_stamp == 6
    assert timing.unpaired == 2


@pytest.mark.parametrize('offset', [50_000, -50_000, 600_000, -900_000, 1_000_000])
def test_pairing_takes_sensors_that_are_read_at_another_time_of_the_period(offset):
    """Each pair once, at the stamp of the joints, and never with a reading a period away."""
    timing = timing_of(pair_tolerance=0.5)
    sent = [
        (k * PERIOD + late, kind)
        for k in range(1, 8)
        for kind, late in ((joints, 0), (wrench, offset))
    ]
    for stamp, kind in sorted(sent, key=lambda each: each[0]):
        timing.add_reading(kind(stamp))
        action, inputs = timing.decide_on_message(0)
        if action is STEP:
            assert abs(inputs.wrench.wrench[0] - timing.last_stamp) <= PERIOD // 2
    assert (timing.tick, timing.last_stamp, timing.unpaired) == (6, 7 * PERIOD, 0)


def test_late_half_of_an_answered_sample_is_not_paired_with_the_next():
    timing = timing_of(pair_tolerance=0.5, patience=1.5)
    sample(timing, 0)
    timing.add_reading(joints(PERIOD))
    action, inputs = timing.decide_on_silence(timing.silence_deadline)
    assert (action, inputs.time, inputs.joints.stamp, inputs.wrench.stamp) == (
        HALF,
        H,
        H,
        0.0,
    )
    assert timing.silence_deadline == 2.5 * PERIOD  # on the grid of the samples
    timing.add_reading(wrench(PERIOD + 50_000))
    assert (
        timing.decide_on_message(0).action is WAIT
        and timing.decide_on_silence(timing.silence_deadline).action is WAIT
    )
    timing.add_reading(joints(2 * PERIOD))
    assert timing.decide_on_message(0).action is WAIT
    timing.add_reading(wrench(2 * PERIOD + 50_000))
    assert (
        timing.decide_on_message(0).action is STEP and timing.last_stamp == 2 * PERIOD
    )


def test_time_is_counted_on_and_does_not_go_back_when_late_samples_come():
    """Samples that are late by three periods, as those of a simulator that has slipped."""
    timing = timing_of(patience=1.5)
    assert timing.silence_deadline == 0
    assert sample(timing, 0).inputs.time == 0.0
    decisions = [
        timing.decide_on_silence(round(x * PERIOD)) for x in (1.4, 1.5, 2.5, 3.5)
    ]
    assert [x.action for x in decisions] == [WAIT, WAIT, WITHOUT, WITHOUT]
    assert [x.inputs.time for x in decisions[2:]] == pytest.approx([2 * H, 3 * H])
    assert timing.answered_stamp == 3 * PERIOD
    times = [
        sample(timing, k * PERIOD, (3 + k) * PERIOD).inputs.time for k in (1, 2, 3)
    ]
    assert times == pytest.approx([4 * H, 5 * H, 6 * H])
    own = [(x.inputs.time - x.inputs.ahead) / H for x in decisions[2:]]
    assert own == pytest.approx([0.0, 0.0], abs=1e-9)
    times = [
        timing.decide_on_silence(round(x * PERIOD)).inputs.time for x in (56.9, 57.5)
    ]
    assert times == pytest.approx(
        [56 * H, 57 * H]
    )  # what was slept through counts once
    assert sample(timing, 66 * PERIOD).action is STEP
    assert timing.skipped == 62
    assert (
        sample(timing, 1_800_000 * PERIOD).action is STEP and timing.skipped == 62
    )  # set ahead
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
    assert (
        timing.silence_deadline == 0 and timing.decide_on_silence(10**12).action is WAIT
    )


@pytest.mark.parametrize('options', [{}, {'supervised': False}, {'lockstep': True}])
def test_repeated_sample_gets_its_command_again_and_an_older_one_is_refused_or_starts_anew(
    options,
):
    """A supervisor takes two in order for a clock that was set back."""
    timing = timing_of(**options)
    sample(timing, 100 * PERIOD)
    assert sample(timing, 100 * PERIOD).action is REPEAT
    if options:
        action, inputs = sample(timing, PERIOD)
        assert (action, inputs.time, timing.tick) == (ANEW, 0.0, 0)
    else:
        assert [sample(timing, k * PERIOD).action for k in (90, 80, 103, 50)] == [
            REFUSE,
            REFUSE,
            STEP,
            REFUSE,
        ]
        action, inputs = sample(timing, 51 * PERIOD)
        assert (action, inputs.time) == (STEP, pytest.approx(-49 * H))


def test_lockstep_waits_for_the_variance_of_the_sample_before_but_not_in_the_safe_behaviour():
    timing = timing_of(lockstep=True)
    assert sample(timing, 0).action is STEP
    assert sample(timing, PERIOD).action is WAIT
    assert (
        sample(timing, PERIOD).action is SHOW
    )  # the estimator has missed the last tick
    timing.add_noise_variance(PERIOD, np.ones(2))  # of no sample so far
    assert timing.decide_on_message(0).action is WAIT and timing.variance is None
    timing.add_noise_variance(0, np.ones(2))
    action, inputs = timing.decide_on_message(0)
    assert (action, inputs.variance.stamp, inputs.time) == (STEP, 0.0, H)
    assert sample(timing, 2 * PERIOD, safe=True).action is STEP


def test_bare_time_goes_in_whole_periods_and_joints_alone_are_a_sample_without_a_sensor():
    timing = timing_of(supervised=False, feels=False)
    for k in range(4):
        timing.add_reading(joints(k * PERIOD + 1000 * (k % 2)))
        action, inputs = timing.decide_on_message(0)
        assert (action, inputs.time, inputs.wrench) == (STEP, k * H, None)
        assert inputs.joints.stamp == pytest.approx(k * H + 1e-6 * (k % 2))


def test_other_half_of_a_sample_that_comes_again_is_no_older_sample():
    """A simulator sends both halves again, and waits for the stamp of its joints."""
    timing = timing_of(pair_tolerance=0.5, patience=1.5)
    sample(timing, 0)
    timing.add_reading(wrench(PERIOD + 50_000))
    assert timing.decide_on_silence(timing.silence_deadline).action is HALF
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
