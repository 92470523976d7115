"""What each message, or its absence, leads to: the rows of the table of `SampleTiming`."""

from hypothesis import given
from hypothesis import strategies as st
from multicontact_control.sampling import Action, SampleTiming
from multicontact_control.supervision.inputs import JointInput, WrenchInput
import numpy as np
import pytest

H = 0.002
PERIOD = 2_000_000
WAIT, STEP, ANEW, HALF, WITHOUT, REPEAT, STALE, SHOW, REFUSE = Action


def joints(stamp):
    return JointInput(stamp, np.full(2, float(stamp)), np.zeros(2))


def wrench(stamp):
    return WrenchInput(stamp, np.full(6, float(stamp)))


def timing_of(**options):
    return SampleTiming(1.0 / H, **options)


def sample(timing, stamp, now=0, **options):
    """Take in a whole sample, and return what to do."""
    timing.add(joints(stamp))
    timing.add(wrench(stamp))
    return timing.what_now(now, **options)


@pytest.mark.parametrize('joints_first', [True, False])
def test_pairing_gives_each_pair_once_in_either_order_and_never_mixes_stamps(joints_first):
    timing = timing_of()
    for stamp in (1, 2, 3):
        halves = [(timing.add, joints(stamp)), (timing.add, wrench(stamp))]
        (first, half), (second, other) = halves if joints_first else halves[::-1]
        first(half)
        assert timing.what_now(0).action is WAIT
        second(other)
        action, inputs = timing.what_now(0)
        assert action is STEP and timing.what_now(0).action is WAIT
        assert (inputs.joints.q[0], inputs.wrench.wrench[0]) == (stamp, stamp)
    assert timing.unpaired == 0
    for add, reading in ((timing.add, joints(4)), (timing.add, wrench(5)),
                         (timing.add, wrench(6))):
        add(reading)
        assert timing.what_now(0).action is WAIT
    assert timing.apart == 2
    timing.add(joints(6))
    assert timing.what_now(0).action is STEP and timing.last_stamp == 6
    assert timing.unpaired == 2


@pytest.mark.parametrize('offset', [50_000, -50_000, 600_000, -900_000, 1_000_000])
def test_sensors_that_are_read_at_another_time_of_the_period_are_paired(offset):
    """Each pair once, at the stamp of the joints, and never with what is a period away."""
    timing = timing_of(pair_tolerance=0.5)
    sent = sorted([(k * PERIOD, 0, joints(k * PERIOD)) for k in range(1, 8)] + [
        (k * PERIOD + offset, 1, wrench(k * PERIOD + offset)) for k in range(1, 8)],
        key=lambda each: each[:2])
    for _, kind, reading in sent:
        (timing.add if kind else timing.add)(reading)
        action, inputs = timing.what_now(0)
        if action is STEP:
            assert abs(inputs.wrench.wrench[0] - timing.last_stamp) <= PERIOD // 2
    assert (timing.tick, timing.last_stamp, timing.unpaired) == (6, 7 * PERIOD, 0)


def test_late_half_of_a_sample_that_was_answered_is_none_of_the_next():
    """The joints alone were answered; their wrench, 50 us newer, is no news."""
    timing = timing_of(pair_tolerance=0.5, patience=1.5)
    sample(timing, 0)
    timing.add(joints(PERIOD))
    action, inputs = timing.late(timing.due)
    assert (action, inputs.time, inputs.joints.stamp, inputs.wrench.stamp) == (HALF, H, H, 0.0)
    timing.add(wrench(PERIOD + 50_000))
    assert timing.what_now(0).action is WAIT and timing.late(timing.due).action is WAIT
    timing.add(joints(2 * PERIOD))
    assert timing.what_now(0).action is WAIT
    timing.add(wrench(2 * PERIOD + 50_000))
    assert timing.what_now(0).action is STEP and timing.last_stamp == 2 * PERIOD


@given(st.integers(0, 2 ** 31 * 10 ** 9))
def test_where_a_clock_starts_does_not_matter(origin):
    timing = timing_of()
    for k in range(5):
        assert sample(timing, origin + k * PERIOD).inputs.time == pytest.approx(k * H, abs=1e-12)


def test_time_is_counted_on_and_does_not_go_back_when_late_samples_come():
    """Samples that are late by three periods, as those of a simulator that has slipped."""
    timing = timing_of(patience=1.5)
    sample(timing, 0)
    found = [timing.late(round(x * PERIOD)) for x in (1.4, 1.5, 2.5, 3.5)]
    assert [x.action for x in found] == [WAIT, WAIT, WITHOUT, WITHOUT]
    assert [x.inputs.time for x in found[2:]] == pytest.approx([2 * H, 3 * H])
    assert timing.expected_stamp == 3 * PERIOD
    times = [sample(timing, k * PERIOD, (3 + k) * PERIOD).inputs.time for k in (1, 2, 3)]
    assert times == pytest.approx([4 * H, 5 * H, 6 * H])


def test_stamps_that_jump_are_no_reason_to_shift_and_are_counted_unless_by_hours():
    timing = timing_of(patience=1.5)
    sample(timing, 0)
    timing.late(round(2.5 * PERIOD))
    assert sample(timing, 7 * PERIOD).inputs.time == pytest.approx(7 * H)
    assert timing.skipped == 6
    assert sample(timing, 1_800_000 * PERIOD).action is STEP and timing.skipped == 6


def test_what_was_slept_through_is_counted_once():
    timing = timing_of(patience=1.5)
    sample(timing, 0)
    times = [timing.late(round(x * PERIOD)).inputs.time for x in (50.9, 51.5)]
    assert times == pytest.approx([50 * H, 51 * H])


def test_halves_are_waited_for_on_the_grid_of_the_samples():
    timing = timing_of(patience=1.5)
    sample(timing, 0)
    for k in (1, 2, 3):
        timing.add(wrench(k * PERIOD))
        assert timing.late(timing.due).action is HALF
        assert timing.due == (k + 1.5) * PERIOD


@pytest.mark.parametrize('options', [
    {'patience': 0.0}, {'patience': 1.5, 'supervised': False},
    {'patience': 1.5, 'lockstep': True}])
def test_a_sample_is_waited_for_without_end_where_none_is_to_be_missed(options):
    timing = timing_of(**options)
    assert timing.due == 0
    assert sample(timing, 0).action is STEP
    assert timing.due == 0 and timing.late(10 ** 12).action is WAIT


def test_nothing_is_missing_before_the_first_sample_and_after_a_restart():
    timing = timing_of(patience=1.5)
    assert timing.due == 0
    sample(timing, 0)
    assert timing.due == 1.5 * PERIOD
    timing.restart()
    assert timing.due == 0


@pytest.mark.parametrize(('options', 'repeats'), [
    ({}, 60), ({'lockstep': True}, 60), ({'supervised': False}, 25)])
def test_a_sample_that_comes_again_gets_its_command_again(options, repeats):
    timing = timing_of(**options)
    sample(timing, 0)
    assert [sample(timing, 0).action for _ in range(60)] == [REPEAT] * repeats + [STALE] * (
        60 - repeats)


def test_one_older_sample_is_refused_and_a_clock_that_was_set_back_is_not():
    timing = timing_of()
    for k in range(100, 103):
        sample(timing, k * PERIOD)
    assert [sample(timing, k * PERIOD).action for k in (90, 80, 103, 50)] == [
        REFUSE, REFUSE, STEP, REFUSE]
    action, inputs = sample(timing, 51 * PERIOD)
    assert (action, inputs.time) == (STEP, pytest.approx(-49 * H))


@pytest.mark.parametrize('options', [{'supervised': False}, {'lockstep': True}])
def test_an_older_sample_starts_everything_anew_where_samples_may_begin_again(options):
    timing = timing_of(**options)
    sample(timing, 100 * PERIOD)
    action, inputs = sample(timing, PERIOD)
    assert (action, inputs.time, timing.tick) == (ANEW, 0.0, 0)


def test_lockstep_waits_for_the_variance_of_the_sample_before_but_not_in_the_safe_behaviour():
    timing = timing_of(lockstep=True)
    assert sample(timing, 0).action is STEP
    assert sample(timing, PERIOD).action is WAIT
    assert sample(timing, PERIOD).action is SHOW  # the estimator has missed the last tick
    timing.add_variance(PERIOD, np.ones(2))  # of no sample so far
    assert timing.what_now(0).action is WAIT and timing.variance is None
    timing.add_variance(0, np.ones(2))
    action, inputs = timing.what_now(0)
    assert (action, inputs.variance.stamp, inputs.time) == (STEP, 0.0, H)
    assert sample(timing, 2 * PERIOD, safe=True).action is STEP


def test_without_a_wrist_sensor_joint_states_are_whole_samples():
    timing = timing_of(feels=False)
    timing.add(joints(5))
    action, inputs = timing.what_now(0)
    assert (action, inputs.wrench, inputs.joints.q[0]) == (STEP, None, 5.0)


def test_bare_the_time_of_the_law_goes_in_whole_periods():
    timing = timing_of(supervised=False)
    inputs = [sample(timing, k * PERIOD + 1000 * (k % 2)).inputs for k in range(4)]
    assert [x.time for x in inputs] == [k * H for k in range(4)]
    assert inputs[1].joints.stamp == pytest.approx(H + 1e-6)
