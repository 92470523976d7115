"""
From readings with stamps to the ticks of the control loop: all policy on time is here.

Stamps are in nanoseconds, of whatever clock stamps the samples. Waiting is measured by the
monotonic clock of this machine [ns].
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from multicontact_control.arrays import Vector
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)

NANOSECONDS = 1_000_000_000
LONGEST_PAUSE = 10.0  # s; stamps that jump farther ahead are of a clock that was set
BARE_REPEATS = 25


@dataclass(frozen=True, slots=True)
class JointReading:
    """Positions [rad], velocities [rad/s] and efforts [N m] of the joints at a time [ns]."""

    stamp: int
    q: Vector
    qd: Vector
    effort: Vector | None = None


@dataclass(frozen=True, slots=True)
class WrenchReading:
    """What a wrist sensor reads [N, N m] at a time [ns], in its own frame."""

    stamp: int
    wrench_sensor: Vector


class Action(Enum):
    """What to do now."""

    WAIT = 'nothing'
    STEP = 'step by a whole sample'
    ANEW = 'forget the past, then step by a whole sample'
    HALF = 'step by half a sample'
    WITHOUT = 'step without a sample'
    REPEAT = 'send the last command again'
    STALE = 'nothing: the same sample has come too often'
    SHOW = 'publish the last tick again, for the estimator that missed it'
    REFUSE = 'refuse the sample: it is older than the last'


class Decision(NamedTuple):
    """What to do now, and the inputs if it is a step."""

    action: Action
    inputs: TickInputs | None = None


class SampleTiming:
    """
    Pairs the readings of one time, and decides what each message, or its absence, leads to.

    ================================== =================== =================== ================
    What has come                      supervised          bare                lockstep
    ================================== =================== =================== ================
    one half of a sample               WAIT                WAIT                WAIT
    both, within `pair_tolerance`      STEP                STEP                STEP with R [1]_
    the same stamp again, answered     REPEAT              REPEAT [2]_         REPEAT
    the same stamp again, waiting      WAIT                WAIT                SHOW
    one sample older than the last     REFUSE              ANEW                ANEW
    a second, not older than the first STEP [3]_           ANEW                ANEW
    no sample for `patience`           HALF if one waits   WAIT                WAIT
    none one period later, or later    WITHOUT [4]_        WAIT                WAIT
    ================================== =================== =================== ================

    Nothing is missing before the first sample. The time of a tick is its stamp less the first;
    bare, the law's time goes in whole periods.

    .. [1] Of the sample before, not in the safe behaviour; WAIT until it is there.
    .. [2] 25 times at most, then STALE: nothing else tells that the arm is not seen any more.
    .. [3] The clock was set back; the watchdog answers that.
    .. [4] Once for each period, in which time is counted on. It does not go back when samples
       come again: their stamps are shifted from then on.

    Parameters
    ----------
    rate
        1 / h [Hz].
    supervised, lockstep, feels
        Whether a supervisor is around the law, R is waited for, and there is a wrist sensor;
        without one joint states alone are whole samples.
    patience, pair_tolerance
        How long the next sample is waited for, 0 for ever, and the largest difference between
        the stamps of a pair [periods].

    Attributes
    ----------
    last_stamp, expected_stamp
        Of the newest sample, and of the one that should have come by now [ns]; -1 for none.
    tick, variance
        Number of the newest sample, from 0, and the newest R, shape (r,) [N^2], or None.
    due
        When `late` is to be asked, monotonic time [ns]; 0 for never.
    unpaired, skipped
        Readings without their other half, and samples that never came or were overtaken.
    apart
        By how much the stamps of the newest two readings differ if they are no pair [ns].

    """

    def __init__(
        self, rate: float, *, supervised: bool = True, lockstep: bool = False, feels: bool = True,
        patience: float = 0.0, pair_tolerance: float = 0.0,
    ) -> None:
        self._rate, self._period = rate, 1.0 / rate
        self._supervised, self._lockstep, self._feels = supervised, lockstep, feels
        self._period_ns = self._period * NANOSECONDS
        self._patience_ns = patience * self._period_ns if supervised and not lockstep else 0.0
        self._tolerance = round(pair_tolerance * self._period_ns)
        self._joints: JointReading | None = None
        self._wrench: WrenchReading | None = None
        self._waiting: tuple[JointReading, WrenchReading | None] | None = None
        self._came_again = False
        self.unpaired = self.apart = 0
        self.restart()

    def restart(self) -> None:
        """Forget the past: the next sample is the first. In lockstep a sample that waits stays."""
        self._forget()
        if not self._lockstep:  # it may be old
            self._waiting = None

    def _forget(self) -> None:
        self._first_stamp: int | None = None
        self._older_stamp: int | None = None
        self._variance_stamp = self.last_stamp = self.expected_stamp = -1
        self.variance: Vector | None = None
        self._inputs = TickInputs(0.0)
        self._time = self._shift = 0.0
        self._counted_on = False
        self._missed = self._repeats = self.tick = self.skipped = 0
        self._since, self._late, self.due = 0.0, 0, 0

    def add(self, reading: JointReading | WrenchReading) -> None:
        """Take in a reading; with its other half it is a sample that waits."""
        if isinstance(reading, JointReading):
            self.unpaired += self._joints is not None
            self._joints = reading
        else:
            self.unpaired += self._wrench is not None
            self._wrench = reading
        joints, wrench = self._joints, self._wrench
        if joints is None or (wrench is None and self._feels):
            return
        self.apart = 0 if wrench is None else wrench.stamp - joints.stamp
        if abs(self.apart) <= self._tolerance:
            self._came_again = (
                self._waiting is not None and self._waiting[0].stamp == joints.stamp)
            self._waiting, self._joints, self._wrench, self.apart = (joints, wrench), None, None, 0

    def add_variance(self, stamp: int, variance: Vector) -> None:
        """Use an R [N^2] from the next tick on; its stamp is that of a sample [ns]."""
        if stamp <= self.last_stamp:  # else left over from before a restart
            self._variance_stamp, self.variance = stamp, variance
            time = (stamp - (self._first_stamp or 0)) * 1e-9 + self._shift
            self._inputs = self._inputs._replace(variance=VarianceInput(time, variance))

    def what_now(self, now: int, *, safe: bool = False) -> Decision:
        """Decide after a message that came `now` [ns], in the safe behaviour if `safe`."""
        if self._waiting is None:
            return Decision(Action.WAIT)
        joints, wrench = self._waiting
        came_again, self._came_again = self._came_again, False
        action = Action.STEP
        if joints.stamp == self.last_stamp:
            self._waiting = None
            self._repeats += 1
            return Decision(Action.REPEAT if self._supervised or self._lockstep or (
                self._repeats <= BARE_REPEATS) else Action.STALE)
        if joints.stamp < self.last_stamp:
            if self._lockstep or not self._supervised:
                self._forget()
                action = Action.ANEW
            elif self._older_stamp is None or joints.stamp < self._older_stamp:
                self._older_stamp, self._waiting = joints.stamp, None
                return Decision(Action.REFUSE)
        elif self._lockstep and not safe and self._variance_stamp != self.last_stamp:
            return Decision(Action.SHOW if came_again else Action.WAIT)
        self._waiting = self._older_stamp = None
        self._repeats = 0
        return Decision(action, self._begin(now, joints, wrench))

    def late(self, now: int) -> Decision:
        """Decide if `due` has passed `now` [ns] and everything that has come is taken in."""
        if not 0 < self.due <= now:
            return Decision(Action.WAIT)
        halves = [half for half in (self._joints, self._wrench) if half is not None
                  and half.stamp > self.last_stamp + self._tolerance]
        if halves:
            newest = max(halves, key=lambda half: half.stamp)
            self.unpaired += 1
            since = max(self._since + self._period_ns, now - self._period_ns)
            if isinstance(newest, JointReading):
                self._joints = None
                return Decision(Action.HALF, self._begin(since, newest, None))
            self._wrench = None
            return Decision(Action.HALF, self._begin(since, None, newest))
        periods_late = int((now - self._since - self._patience_ns) // self._period_ns)
        passed = int((now - self._since) // self._period_ns) if periods_late else 0
        ticks, self._late = passed - self._late, passed
        self.due = int(self._since + self._patience_ns + (periods_late + 1) * self._period_ns)
        if not ticks:  # what is only late is waited for one more period
            return Decision(Action.WAIT)
        self._missed += ticks
        self.expected_stamp = self.last_stamp + round(self._missed * self._period * 1e9)
        self._counted_on = True
        self._time += ticks * self._period
        self._inputs = self._inputs._replace(time=self._time)
        return Decision(Action.WITHOUT, self._inputs)

    def _begin(
        self, since: float, joints: JointReading | None, wrench: WrenchReading | None,
    ) -> TickInputs:
        """
        Begin the tick of a sample, and wait for the next `since` then, monotonic [ns].

        Returns the newest of each input, at the time of the sample.
        """
        stamp = joints.stamp if joints is not None else wrench.stamp if wrench is not None else 0
        if self._first_stamp is None:
            self._first_stamp = stamp
        tick = round((stamp - self._first_stamp) * 1e-9 * self._rate)
        missed = tick - self.tick - 1
        if 0 < missed <= LONGEST_PAUSE * self._rate:
            self.skipped += missed
        self.tick, self.last_stamp, self.expected_stamp = tick, stamp, stamp
        time = (stamp - self._first_stamp) * 1e-9 + self._shift
        if self._counted_on and time <= self._time:
            self._shift += self._time + self._period - time
            time = self._time + self._period
        self._counted_on, self._missed, self._time = False, 0, time
        self._since, self._late = since, 0
        self.due = int(since + self._patience_ns) if self._patience_ns else 0
        self._inputs = TickInputs(
            time if self._supervised else tick * self._period,
            self._inputs.joints if joints is None else JointInput(
                time, joints.q, joints.qd, joints.effort),
            self._inputs.wrench if wrench is None else WrenchInput(time, wrench.wrench_sensor),
            self._inputs.variance)
        return self._inputs
