"""What a node tells of its loop: all turns and latencies once, misses only where it counts."""

from multicontact_control.nodes.diagnostics import DurationLog, LoopStatistics
import pytest


class BusyLog(DurationLog):
    """Durations of a loop that goes on while a report is made."""

    def percentiles(self, *span, **options):
        values = super().percentiles(*span, **options)
        self.add(7_000)
        return values


def test_log_reads_the_durations_between_two_counts():
    log = DurationLog()
    for microseconds in (1, 2, 3, 4):
        log.add(1000 * microseconds)
    assert log.microseconds(1, 3).tolist() == [2.0, 3.0]
    assert log.percentiles(1, 3, expected=5.0)['max'] == 3.0
    assert log.percentiles(4)['max'] is None


def test_what_a_loop_adds_during_a_report_is_in_the_next_one():
    statistics = LoopStatistics(500.0)
    statistics.intervals = BusyLog()
    statistics.latencies = BusyLog()
    first = statistics.report()
    assert first['rate_hz'] == 0.0
    assert first['latency_us_max'] is None
    second = statistics.report()
    assert second['rate_hz'] > 0.0
    assert second['jitter_us_p99'] == pytest.approx(1993.0)
    assert second['latency_us_max'] == 7.0


def test_loop_tells_of_no_deadlines_that_it_does_not_count():
    assert 'deadline_misses' not in LoopStatistics(500.0).report()
