"""
From the readings that come to the samples that are answered, and what is missing of them.

Stamps are in nanoseconds, of whatever clock stamps the samples.
"""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import Vector


@dataclass(frozen=True, slots=True)
class JointReading:
    """
    Joint positions [rad] and velocities [rad/s] at a time, in the order that was asked for.

    The effort [N m] is None if it was not asked for, or not all there.
    """

    stamp: int
    q: Vector
    qd: Vector
    effort: Vector | None = None


@dataclass(frozen=True, slots=True)
class WrenchReading:
    """What a wrist sensor reads [N, N m] at a time, in its own frame."""

    stamp: int
    wrench_sensor: Vector


@dataclass(frozen=True, slots=True)
class MotionReading:
    """A commanded pose, twist and acceleration of the operational point, in world axes."""

    position_world: Vector
    quaternion_xyzw: Vector
    twist_world: Vector
    acceleration_world: Vector


@dataclass(frozen=True, slots=True)
class PairedSample:
    """Joint state and wrist wrench at the stamp of the joints [ns]; the effort if it was read."""

    stamp: int
    q: Vector
    qd: Vector
    wrench_sensor: Vector
    effort: Vector | None = None


class SamplePairing:
    """
    Pairs readings of one time and hands out the newest pair once.

    One message of a kind is kept: the two topics are filled together, so what waits is at most
    the half of the newest sample, and halves that never met are counted. With a tolerance of half
    a period two sensors that are read at one rate, but not at one time, always find each other.

    Parameters
    ----------
    tolerance
        Largest difference between the stamps of a pair [ns]; 0 for equal ones alone.

    Attributes
    ----------
    unpaired
        Readings that were overtaken before their other half came.
    apart
        By how much the stamps of the newest two differ if they are no pair [ns].

    """

    def __init__(self, tolerance: int = 0) -> None:
        self._joints: JointReading | None = None
        self._wrench: WrenchReading | None = None
        self._tolerance = tolerance
        self.unpaired = self.apart = 0

    def add_joints(self, reading: JointReading) -> PairedSample | None:
        """Take in a joint state; return the pair if it completes one."""
        self.unpaired += self._joints is not None
        self._joints = reading
        return self._pair()

    def add_wrench(self, reading: WrenchReading) -> PairedSample | None:
        """Take in a wrench; return the pair if it completes one."""
        self.unpaired += self._wrench is not None
        self._wrench = reading
        return self._pair()

    def take_half(self, after: int) -> JointReading | WrenchReading | None:
        """Return the newest half that waits, if it is newer than of the sample of a stamp [ns]."""
        halves = [reading for reading in (self._joints, self._wrench) if reading is not None]
        newest = max(halves, key=lambda reading: reading.stamp, default=None)
        if newest is None or newest.stamp <= after + self._tolerance:
            return None
        self.unpaired += 1
        if newest is self._joints:
            self._joints = None
        else:
            self._wrench = None
        return newest

    def _pair(self) -> PairedSample | None:
        joints, wrench = self._joints, self._wrench
        if joints is None or wrench is None:
            return None
        if joints.stamp != wrench.stamp and (
                abs(wrench.stamp - joints.stamp) > self._tolerance):
            self.apart = wrench.stamp - joints.stamp
            return None
        self.apart = 0
        self._joints = self._wrench = None
        return PairedSample(joints.stamp, joints.q, joints.qd, wrench.wrench_sensor, joints.effort)


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
