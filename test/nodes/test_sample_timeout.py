"""When a sample is no longer waited for."""

from multicontact_control.nodes.sample_timeout import SampleTimeout

PERIOD = 2_000_000


def ticks_at(patience, *periods):
    return [patience.missed(round(x * PERIOD)) for x in periods]


def test_late_sample_gets_one_more_period_and_then_every_period_is_counted():
    patience = SampleTimeout(1.5, PERIOD)
    assert patience.due == 0
    patience.start(0)
    assert patience.due == 1.5 * PERIOD
    assert ticks_at(patience, 1.5) == [0]
    assert patience.due == 2.5 * PERIOD
    assert ticks_at(patience, 2.5, 3.5, 4.6) == [2, 1, 1]
    assert patience.due == 5.5 * PERIOD


def test_what_was_slept_through_is_counted_once():
    patience = SampleTimeout(1.5, PERIOD)
    patience.start(0)
    assert ticks_at(patience, 50.9, 51.5) == [50, 1]


def test_halves_are_waited_for_on_the_grid_of_the_samples():
    patience = SampleTimeout(1.5, PERIOD)
    patience.start(0)
    for k in (1, 2, 3):
        patience.half_used(patience.due)
        assert patience.due == (k + 1.5) * PERIOD


def test_nothing_is_due_without_samples_or_without_end_of_patience():
    patience = SampleTimeout(0.0, PERIOD)
    patience.start(0)
    assert patience.due == 0
    patience = SampleTimeout(1.5, PERIOD)
    patience.start(0)
    patience.stop()
    assert patience.due == 0
