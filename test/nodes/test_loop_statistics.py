"""Rates, jitter, ages and refusals from what is known."""

from multicontact_control.errors import MessageError, RunError, ShapeError
from multicontact_control.nodes.graph_node import Refusals
from multicontact_control.nodes.loop_statistics import Freshness, LoopStatistics
import pytest
from rclpy.logging import get_logger

MS = 1_000_000


def test_report_gives_jitter_latency_and_misses_since_the_last():
    watch = LoopStatistics(500.0)
    for k in range(101):
        watch.add_period(1 + k * 2 * MS + (k % 2) * MS // 10)  # 0.1 ms early and late in turn
        watch.add_latency(300_000 + k * 1000)
    watch.missed = 3
    values = watch.report()
    assert values['jitter_us_p50'] == pytest.approx(100.0)
    assert values['latency_us_p50'] == pytest.approx(350.0)
    assert values['latency_us_max'] == pytest.approx(400.0)
    assert values['deadline_misses'] == 3
    values = watch.report()
    assert (values['deadline_misses'], values['latency_us_p50']) == (0, None)


def test_freshness_knows_what_never_came():
    fresh = Freshness()
    fresh.expect('a', 'b')
    fresh.note('a')
    ages = fresh.ages()
    assert ages['a'] >= 0.0 and ages['b'] is None


@pytest.mark.parametrize('make', [
    lambda k: ShapeError('q', (6,), (k,)), lambda k: RunError(f'x: expected 1, found {k}'),
    lambda k: MessageError('effort', 'finite numbers', [float(k)])])
def test_refusals_count_a_cause_as_one_whatever_was_found(make):
    refusals = Refusals(get_logger('test'))
    for source, k in (('~/tare', 1), ('~/tare', 2), ('~/tare', 3), ('~/hold', 1)):
        refusals.refuse(source, make(k))
    assert sorted(refusals.counts.values()) == [1, 3]
