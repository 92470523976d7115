"""Durations of a run, kept without allocating."""

from __future__ import annotations

import numpy as np

CAPACITY = 1 << 18


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
