"""Pairing by stamp, the clock of the ticks, and when a sample is no longer waited for."""

from hypothesis import given
from hypothesis import strategies as st
from multicontact_control.sampling import (
    JointReading,
    SampleClock,
    SamplePairing,
    SampleTimeout,
    WrenchReading,
)
import numpy as np
import pytest

H = 0.002
PERIOD = 2_000_000


def joints(stamp):
    return JointReading(stamp, np.full(2, float(stamp)), np.zeros(2))


def wrench(stamp):
    return WrenchReading(stamp, np.full(6, float(stamp)))


@pytest.mark.parametrize('joints_first', [True, False])
def test_pairing_gives_each_pair_once_in_either_order_and_never_mixes_stamps(joints_first):
    pairing = SamplePairing()
    for stamp in (1, 2, 3):
        halves = [(pairing.add_joints, joints(stamp)), (pairing.add_wrench, wrench(stamp))]
        (first, half), (second, other) = halves if joints_first else halves[::-1]
        assert first(half) is None
        pair = second(other)
        assert (pair.stamp, pair.q[0], pair.wrench_sensor[0]) == (stamp, stamp, stamp)
    assert pairing.unpaired == 0
    assert pairing.add_joints(joints(4)) is pairing.add_wrench(wrench(5)) is None
    assert pairing.add_wrench(wrench(6)) is None
    assert pairing.add_joints(joints(6)).stamp == 6
    assert pairing.unpaired == 2


@pytest.mark.parametrize('offset', [50_000, -50_000, 600_000, -900_000, 1_000_000])
def test_sensors_that_are_read_at_another_time_of_the_period_are_paired(offset):
    """Each pair once, at the stamp of the joints, and never with what is a period away."""
    pairing = SamplePairing(tolerance=PERIOD // 2)
    sent = sorted([(k * PERIOD, 0, joints(k * PERIOD)) for k in range(1, 8)] + [
        (k * PERIOD + offset, 1, wrench(k * PERIOD + offset)) for k in range(1, 8)],
        key=lambda each: each[:2])
    pairs = [pair for _, kind, reading in sent if (pair := (
        pairing.add_wrench if kind else pairing.add_joints)(reading)) is not None]
    assert [pair.stamp for pair in pairs] == [k * PERIOD for k in range(1, 8)]
    assert all(abs(pair.wrench_sensor[0] - pair.stamp) <= PERIOD // 2 for pair in pairs)
    assert pairing.unpaired == 0


def test_late_half_of_a_sample_that_was_answered_is_none_of_the_next():
    """The joints alone were answered; their wrench, 50 us newer, is no news."""
    pairing = SamplePairing(tolerance=PERIOD // 2)
    pairing.add_joints(joints(PERIOD))
    assert pairing.take_half(0).stamp == PERIOD
    assert pairing.add_wrench(wrench(PERIOD + 50_000)) is None
    assert pairing.take_half(PERIOD) is None
    assert pairing.add_joints(joints(2 * PERIOD)) is None
    assert pairing.add_wrench(wrench(2 * PERIOD + 50_000)).stamp == 2 * PERIOD
    assert SamplePairing().take_half(0) is None


@given(st.integers(-2 ** 31 * 10 ** 9, 2 ** 31 * 10 ** 9))
def test_where_a_clock_starts_does_not_matter(origin):
    clock = SampleClock(H)
    for k in range(5):
        assert clock.take(origin + k * PERIOD) == pytest.approx(k * H, abs=1e-12)


def test_a_gap_is_counted_on_and_left_behind_when_samples_come_again():
    """Samples that are late by three periods, as those of a simulator that has slipped."""
    clock = SampleClock(H)
    clock.take(0)
    assert clock.count_on(2) == pytest.approx(2 * H)
    assert clock.count_on(1) == pytest.approx(3 * H)
    times = [clock.take(k * PERIOD) for k in (1, 2, 3)]
    assert times == pytest.approx([4 * H, 5 * H, 6 * H])


def test_stamps_that_jump_are_no_reason_to_shift():
    clock = SampleClock(H)
    clock.take(0)
    clock.count_on(2)
    assert clock.take(7 * PERIOD) == pytest.approx(7 * H)
    assert clock.take(-100 * PERIOD) == pytest.approx(-100 * H)  # set back, and seen to be


def ticks_at(timeout, *periods):
    return [timeout.missed(round(x * PERIOD)) for x in periods]


def test_late_sample_gets_one_more_period_and_then_every_period_is_counted():
    timeout = SampleTimeout(1.5, PERIOD)
    assert timeout.due == 0
    timeout.start(0)
    assert timeout.due == 1.5 * PERIOD
    assert ticks_at(timeout, 1.5) == [0]
    assert timeout.due == 2.5 * PERIOD
    assert ticks_at(timeout, 2.5, 3.5, 4.6) == [2, 1, 1]
    assert timeout.due == 5.5 * PERIOD


def test_what_was_slept_through_is_counted_once():
    timeout = SampleTimeout(1.5, PERIOD)
    timeout.start(0)
    assert ticks_at(timeout, 50.9, 51.5) == [50, 1]


def test_halves_are_waited_for_on_the_grid_of_the_samples():
    timeout = SampleTimeout(1.5, PERIOD)
    timeout.start(0)
    for k in (1, 2, 3):
        timeout.half_used(timeout.due)
        assert timeout.due == (k + 1.5) * PERIOD


def test_nothing_is_due_without_samples_or_without_end_of_timeout():
    timeout = SampleTimeout(0.0, PERIOD)
    timeout.start(0)
    assert timeout.due == 0
    timeout = SampleTimeout(1.5, PERIOD)
    timeout.start(0)
    timeout.stop()
    assert timeout.due == 0
