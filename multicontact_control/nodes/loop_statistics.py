"""How regular a loop is, how long its turns take, and how fresh its inputs are."""

from __future__ import annotations

from collections.abc import Mapping
import time

from multicontact_control.arrays import Vector
import numpy as np

NANOSECONDS = 1_000_000_000
CAPACITY = 1 << 18  # 8 minutes at 500 Hz
REPORTED = 1 << 12  # turns that a report is made of, at most
PERCENTILES = {'p50': 50.0, 'p99': 99.0, 'p999': 99.9, 'max': 100.0}
EDGES = np.logspace(1.0, 5.0, 41)  # us, of a histogram: ten per decade, 10 us to 100 ms


class DurationLog:
    """The newest durations, `capacity` at most."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._nanoseconds = np.zeros(capacity, dtype=np.int64)
        self.count = 0

    def add(self, nanoseconds: int) -> None:
        """Keep one duration [ns]."""
        self._nanoseconds[self.count % self._nanoseconds.size] = nanoseconds
        self.count += 1

    @property
    def microseconds(self) -> Vector:
        """Return those that are kept [us]."""
        kept = self._nanoseconds[:min(self.count, self._nanoseconds.size)]
        return np.asarray(1e-3 * kept, dtype=np.float64)

    def percentiles(self) -> dict[str, float | None]:
        """Return median, tails and maximum [us]; None without any duration."""
        kept = self.microseconds
        return {name: _percentile(kept, share, 3) for name, share in PERCENTILES.items()}

    def histogram(self) -> dict[str, list[float] | list[int]]:
        """Return how many there are from one edge [us] to the next, first and last with all."""
        kept = np.clip(self.microseconds, EDGES[0], EDGES[-1])
        return {'edges_us': EDGES.round(1).tolist(),
                'counts': np.histogram(kept, EDGES)[0].tolist()}


def _percentile(microseconds: Vector, share: float, digits: int) -> float | None:
    return round(float(np.percentile(microseconds, share)), digits) if (
        microseconds.size) else None


class LoopStatistics:
    """
    Rate, jitter and latency since the last report.

    The loop should run at `rate` [Hz], 0 if there is none; the node counts deadlines as `missed`.
    """

    def __init__(self, rate: float = 0.0) -> None:
        self._period = 1e6 / rate if rate else 0.0
        self._last = 0
        self._begin()

    def _begin(self) -> None:
        self._intervals, self._latencies = DurationLog(REPORTED), DurationLog(REPORTED)
        self._report_start = time.monotonic_ns()
        self.missed = 0

    def add_period(self, now: int) -> None:
        """Take note of a turn of the loop at a monotonic time [ns]."""
        if self._last:
            self._intervals.add(now - self._last)
        self._last = now

    def add_latency(self, latency: int) -> None:
        """Take note of the time from a sample to its answer [ns]."""
        self._latencies.add(latency)

    def report(self) -> dict[str, float | int | None]:
        """
        Return what was seen since the last call, by name with unit.

        Jitter is the deviation of an interval from the period, or from the median interval.
        """
        elapsed = max(1, time.monotonic_ns() - self._report_start)
        intervals, latencies = self._intervals.microseconds, self._latencies.microseconds
        period = self._period or (np.median(intervals) if intervals.size else 0.0)
        jitter = np.abs(intervals - period)
        values: dict[str, float | int | None] = {
            'rate_hz': round(self._intervals.count * NANOSECONDS / elapsed, 2),
            'deadline_misses': self.missed}
        for name, found, shares in (('jitter', jitter, ('p50', 'p99')),
                                    ('latency', latencies, ('p50', 'p99', 'max'))):
            for share in shares:
                values[f'{name}_us_{share}'] = _percentile(found, PERCENTILES[share], 1)
        self._begin()
        return values


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

    def ages(self) -> Mapping[str, float | None]:
        """Return the age of the newest of every input [s], None where there never was one."""
        now = time.monotonic_ns()
        return {name: (now - last) * 1e-9 if last else None
                for name, last in self._last.items()}
