"""How regular a loop is, how long its turns take, and how fresh its inputs are."""

from __future__ import annotations

from collections.abc import Mapping
import time

from multicontact_control.arrays import Vector
import numpy as np

NANOSECONDS = 1_000_000_000
CAPACITY = 1 << 18


class LoopStatistics:
    """
    Rate, jitter and latency since the last report.

    Parameters
    ----------
    rate
        How often the loop should run [Hz], 0 if there is no such rate.

    Attributes
    ----------
    missed
        Deadlines missed since the last report; whoever knows of one adds it.

    """

    def __init__(self, rate: float = 0.0) -> None:
        self._period = NANOSECONDS / rate if rate else 0.0
        self._last = 0
        self._intervals: list[int] = []
        self._latencies: list[int] = []
        self._report_start = time.monotonic_ns()
        self.missed = 0
        self.missed_in_all = 0

    def add_period(self, now: int) -> None:
        """Take note of a turn of the loop at a monotonic time [ns]."""
        if self._last:
            self._intervals.append(now - self._last)
        self._last = now

    def add_latency(self, latency: int) -> None:
        """Take note of the time from a sample to its answer [ns]."""
        self._latencies.append(latency)

    def report(self) -> dict[str, float | int | None]:
        """
        Return what was seen since the last call, by name with unit.

        Jitter is the deviation of an interval from the period, or from the median interval.
        """
        now = time.monotonic_ns()
        elapsed = max(1, now - self._report_start)
        self.missed_in_all += self.missed
        intervals = np.array(self._intervals, dtype=float)
        period = self._period or (np.median(intervals) if intervals.size else 0.0)
        jitter = np.abs(intervals - period)
        latencies = np.array(self._latencies, dtype=float)
        values: dict[str, float | int | None] = {
            'rate_hz': round(len(intervals) * NANOSECONDS / elapsed, 2),
            'jitter_us_p50': _percentile(jitter, 50), 'jitter_us_p99': _percentile(jitter, 99),
            'deadline_misses': self.missed, 'deadline_misses_in_all': self.missed_in_all,
            'latency_us_p50': _percentile(latencies, 50),
            'latency_us_p99': _percentile(latencies, 99),
            'latency_us_max': _percentile(latencies, 100)}
        self._intervals, self._latencies = [], []
        self._report_start, self.missed = now, 0
        return values


def _percentile(nanoseconds: Vector, share: int) -> float | None:
    return round(float(np.percentile(nanoseconds, share)) * 1e-3, 1) if (
        nanoseconds.size) else None


class DurationLog:
    """
    The newest durations.

    Parameters
    ----------
    capacity
        How many are kept: the default is 8 minutes at 500 Hz.

    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._nanoseconds = np.zeros(capacity, dtype=np.int64)
        self.count = 0

    def add(self, nanoseconds: int) -> None:
        """Keep one duration [ns]."""
        self._nanoseconds[self.count % self._nanoseconds.size] = nanoseconds
        self.count += 1

    def percentiles(self) -> dict[str, float | None]:
        """Return median, tails and maximum [us]; None without any duration."""
        kept = self._nanoseconds[:self.count] if (
            self.count < self._nanoseconds.size) else self._nanoseconds
        if not kept.size:
            return dict.fromkeys(('p50', 'p99', 'p999', 'max'))
        p50, p99, p999 = np.percentile(kept, (50.0, 99.0, 99.9)) * 1e-3
        return {'p50': round(float(p50), 3), 'p99': round(float(p99), 3),
                'p999': round(float(p999), 3), 'max': round(float(kept.max()) * 1e-3, 3)}


class Freshness:
    """When each input last came."""

    def __init__(self) -> None:
        self._last: dict[str, int] = {}

    def expect(self, *names: str) -> None:
        """Forget the past; these inputs are waited for from now on."""
        self._last = dict.fromkeys(names, 0)

    def note(self, name: str) -> int:
        """Take note of an input; return the monotonic time [ns]."""
        now = time.monotonic_ns()
        self._last[name] = now
        return now

    @staticmethod
    def elapsed(since: int) -> int:
        """Return the time since a monotonic time [ns]."""
        return time.monotonic_ns() - since

    def ages(self) -> Mapping[str, float | None]:
        """Return the age of the newest of every input [s], None where there never was one."""
        now = time.monotonic_ns()
        return {name: (now - last) * 1e-9 if last else None
                for name, last in self._last.items()}
