"""How long a sample is waited for."""

from __future__ import annotations


class SampleTimeout:
    """
    Says when a sample is late, and then when each of the following is.

    Parameters
    ----------
    periods
        How long to wait from one sample to the next [periods]; 0 for ever.
    period
        h [ns].

    Attributes
    ----------
    due
        When it is over, monotonic time [ns]; 0 for never.

    """

    def __init__(self, periods: float, period: float) -> None:
        self._wait, self._period = periods * period, period
        self.stop()

    def stop(self) -> None:
        """Wait for ever, until a sample has come."""
        self.due = 0
        self._since = 0.0
        self._counted = 0

    def start(self, now: int) -> None:
        """Wait for the next sample from one that has come now [ns]."""
        if self._wait:
            self._set(now)

    def half_used(self, now: int) -> None:
        """Wait for the next sample from one of which only a half came, and was waited for."""
        self._set(max(self._since + self._period, now - self._period))

    def _set(self, since: float) -> None:
        self._since, self._counted = since, 0
        self.due = int(since + self._wait)

    def missed(self, now: int) -> int:
        """
        Return how many ticks are to be taken at once now that nothing has come.

        None at first: what is only late is waited for one more period.
        """
        late = int((now - self._since - self._wait) // self._period)
        passed = int((now - self._since) // self._period) if late else 0
        ticks, self._counted = passed - self._counted, passed
        self.due = int(self._since + self._wait + (late + 1) * self._period)
        return ticks
