"""The clock of the ticks: that of the stamps, whatever it is, and never back by itself."""

from hypothesis import given
from hypothesis import strategies as st
from multicontact_control.nodes.sample_clock import SampleClock
import pytest

H = 0.002
PERIOD = 2_000_000


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


def test_a_gap_in_the_stamps_themselves_is_no_reason_to_shift():
    clock = SampleClock(H)
    clock.take(0)
    clock.count_on(2)
    assert clock.take(7 * PERIOD) == pytest.approx(7 * H)


def test_a_clock_that_is_set_back_is_seen_to_be():
    clock = SampleClock(H)
    clock.take(100 * PERIOD)
    assert clock.take(0) == pytest.approx(-0.2)
