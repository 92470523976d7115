"""When a tick is, on the clock of whoever stamps the samples."""

from __future__ import annotations


class SampleClock:
    """
    Turns stamps into the time of a supervisor, and goes on when no stamps come.

    Only stamps are compared with stamps. What clock they are of does not matter: the simulator's
    count from the wall clock at its start, in lockstep from one period, a robot's may count from
    its boot, and may be off from this machine's by any amount or drift against it. Where samples
    fail to come, their time is counted on in periods. If they come after all, later than that,
    time does not go back: what their clock has lost is made up for from then on.

    Parameters
    ----------
    period
        h [s].

    Attributes
    ----------
    now
        Time of the newest tick since the first [s].

    """

    def __init__(self, period: float) -> None:
        self._period = period
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next stamp is the first."""
        self._origin: int | None = None
        self._shift = 0.0
        self._counted_on = False
        self.now = 0.0

    def time_of(self, stamp: int) -> float:
        """Return the time [s] of a stamp [ns]."""
        if self._origin is None:
            self._origin = stamp
        return (stamp - self._origin) * 1e-9 + self._shift

    def take(self, stamp: int) -> float:
        """Begin the tick of a sample with this stamp [ns], and return its time [s]."""
        time = self.time_of(stamp)
        if self._counted_on and time <= self.now:
            self._shift += self.now + self._period - time
            time = self.now + self._period
        self._counted_on = False
        self.now = time
        return time

    def count_on(self, periods: int) -> float:
        """Begin a tick without a sample, some periods after the last, and return its time [s]."""
        self._counted_on = True
        self.now += periods * self._period
        return self.now
