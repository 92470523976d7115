"""
From readings with stamps to the ticks of the control loop: all policy on time is here.

Stamps are in nanoseconds, of whatever clock stamps the samples. Waiting is measured by the
monotonic clock of this machine [ns].
"""

from __future__ import annotations

from enum import Enum
from typing import Any, NamedTuple

from multicontact_control.arrays import Vector
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)

NANOSECONDS = 1_000_000_000
LONGEST_PAUSE = 10.0  # s; stamps that jump farther ahead are of a clock that was set


class Action(Enum):
    """What to do now."""

    WAIT = 'nothing'
    STEP = 'step by a whole sample'
    ANEW = 'forget the past, then step by a whole sample'
    HALF = 'step by half a sample'
    WITHOUT = 'step without a sample'
    REPEAT = 'send the newest torque again, as the answer to this sample'
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
    the same stamp again, answered     REPEAT              REPEAT              REPEAT
    the same stamp again, waiting      WAIT                WAIT                SHOW
    one sample older than the last     REFUSE              ANEW                ANEW
    a second, not older than the first STEP [2]_           ANEW                ANEW
    no sample for `patience`           HALF if one waits   WAIT                WAIT
    none one period later, or later    WITHOUT [3]_        WAIT                WAIT
    ================================== =================== =================== ================

    Nothing is missing before the first sample. The time of a tick is its stamp less the first;
    bare, the law's time goes in whole periods.

    A robot that waits for the answer to its sample, and publishes the sample again until it has
    that, gets it: every answer has the stamp of the newest sample, also after steps without one.

    .. [1] Of the sample before, not in the safe behaviour; WAIT until it is there.
    .. [2] The clock was set back; the watchdog answers that.
    .. [3] Once for each period, in which time is counted on. It does not go back when samples
       come again: their stamps are shifted from then on, and `TickInputs.ahead` says by how much.

    Parameters
    ----------
    rate, supervised, lockstep, feels
        1 / h [Hz]; whether a supervisor is around the law, R is waited for, and there is a wrist
        sensor, without which joint states alone are whole samples.
    patience, pair_tolerance
        How long the next sample is waited for, 0 for ever, and the largest difference between
        the stamps of a pair [periods].

    Attributes
    ----------
    last_stamp, answered_stamp, tick
        Of the newest sample, and of what is answered now: a sample, or one that should have come
        by now [ns], -1 for none; the number of the newest, from 0.
    variance, due
        The newest R, shape (r,) [N^2], or None; the monotonic time of `late` [ns], 0 for never.
    unpaired, skipped, apart, tolerance
        Readings without their other half; samples that never came or were overtaken; by how much
        the stamps of the newest two readings differ, 0 once they pair, and may in a pair [ns].

    """

    def __init__(
        self,
        rate: float,
        *,
        supervised: bool = True,
        lockstep: bool = False,
        feels: bool = True,
        patience: float = 0.0,
        pair_tolerance: float = 0.0,
    ) -> None:
        self._rate, self._period = rate, 1.0 / rate
        self._supervised, self._lockstep, self._feels = supervised, lockstep, feels
        self._period_ns = self._period * NANOSECONDS
        self._patience_ns = (
            patience * self._period_ns if supervised and not lockstep else 0.0
        )
        self.tolerance = round(pair_tolerance * self._period_ns)
        self._halves: dict[type, Any] = {}
        self._waiting: tuple[int, JointInput | None, WrenchInput | None] | None = None
        self._came_again = False
        self.unpaired = self.apart = 0
        self.restart()

    def restart(self) -> None:
        """Forget the past: the next sample is the first. In lockstep a sample that waits stays."""
        if not self._lockstep:  # it may be old
            self._waiting = None
        self._first_stamp: int | None = None
        self._older_stamp: int | None = None
        self._variance_stamp = self.last_stamp = self.answered_stamp = -1
        self.variance: Vector | None = None
        self._inputs = TickInputs(0.0)
        self._time = self._shift = self._since = 0.0
        self._late = 0  # periods without a sample since the newest one
        self._half_answered = False  # whether the newest sample came as one half
        self.tick = self.skipped = self.due = 0

    def add(self, reading: JointInput | WrenchInput) -> None:
        """Take in a reading; with its other half it is a sample that waits."""
        self.unpaired += type(reading) in self._halves
        self._halves[type(reading)] = reading
        joints, wrench = self._halves.get(JointInput), self._halves.get(WrenchInput)
        if joints is None or (wrench is None and self._feels):
            return
        self.apart = 0 if wrench is None else wrench.stamp - joints.stamp
        if abs(self.apart) <= self.tolerance:
            self._came_again = (
                self._waiting is not None and self._waiting[0] == joints.stamp
            )
            self._waiting = joints.stamp, joints, wrench
            self._halves, self.apart = {}, 0

    def add_variance(self, stamp: int, variance: Vector) -> None:
        """Use an R [N^2] from the next tick on; its stamp is that of a sample [ns]."""
        if stamp <= self.last_stamp:  # else left over from before a restart
            self._variance_stamp, self.variance = stamp, variance
            time = (stamp - (self._first_stamp or 0)) * 1e-9 + self._shift
            self._inputs = self._inputs._replace(variance=VarianceInput(time, variance))

    def what_now(self, now: float, *, safe: bool = False) -> Decision:
        """Decide after a message that came `now` [ns], in the safe behaviour if `safe`."""
        if self._waiting is None:
            return Decision(Action.WAIT)
        stamp, joints, wrench = self._waiting
        came_again, self._came_again = self._came_again, False
        action = Action.STEP
        comes_again = stamp == self.last_stamp
        if self._half_answered and self.last_stamp >= 0:  # or it is its other half
            comes_again = abs(stamp - self.last_stamp) <= self.tolerance
        if comes_again:
            self._waiting, self.answered_stamp = None, stamp
            return Decision(Action.REPEAT)
        if stamp < self.last_stamp:
            if self._lockstep or not self._supervised:
                self.restart()
                action = Action.ANEW
            elif self._older_stamp is None or stamp < self._older_stamp:
                self._older_stamp, self._waiting = stamp, None
                return Decision(Action.REFUSE)
        elif self._lockstep and not safe and self._variance_stamp != self.last_stamp:
            return Decision(Action.SHOW if came_again else Action.WAIT)
        if self._first_stamp is None:
            self._first_stamp = stamp
        tick = round((stamp - self._first_stamp) * 1e-9 * self._rate)
        missed = tick - self.tick - 1
        if 0 < missed <= LONGEST_PAUSE * self._rate:
            self.skipped += missed
        time = (stamp - self._first_stamp) * 1e-9 + self._shift
        if self._late and time <= self._time:
            self._shift += self._time + self._period - time
            time = self._time + self._period
        self._waiting = self._older_stamp = None
        self.tick, self.last_stamp, self.answered_stamp = tick, stamp, stamp
        self._time, self._since, self._late = time, now, 0
        self._half_answered = joints is None or (wrench is None and self._feels)
        self.due = int(now + self._patience_ns) if self._patience_ns else 0
        before = self._inputs
        self._inputs = TickInputs(
            time if self._supervised else tick * self._period,
            joints._replace(stamp=time) if joints else before.joints,
            wrench._replace(stamp=time) if wrench else before.wrench,
            before.variance,
            self._shift,
        )
        return Decision(action, self._inputs)

    def late(self, now: int) -> Decision:
        """Decide if `due` has passed `now` [ns] and everything that has come is taken in."""
        if not 0 < self.due <= now:
            return Decision(Action.WAIT)
        newest = max(self._halves.values(), key=lambda half: half.stamp, default=None)
        if newest is not None and newest.stamp > self.last_stamp + self.tolerance:
            del self._halves[type(newest)]
            self.unpaired += 1
            self._waiting = (
                newest.stamp,
                *((newest, None) if isinstance(newest, JointInput) else (None, newest)),
            )
            since = max(self._since + self._period_ns, now - self._period_ns)
            return Decision(Action.HALF, self.what_now(since).inputs)
        periods_late = int((now - self._since - self._patience_ns) // self._period_ns)
        passed = int((now - self._since) // self._period_ns) if periods_late else 0
        ticks, self._late = passed - self._late, passed
        self.due = int(
            self._since + self._patience_ns + (periods_late + 1) * self._period_ns
        )
        if not ticks:  # what is only late is waited for one more period
            return Decision(Action.WAIT)
        self.answered_stamp = self.last_stamp + round(passed * self._period * 1e9)
        counted = ticks * self._period
        self._time += counted
        self._inputs = self._inputs._replace(
            time=self._time, ahead=self._inputs.ahead + counted
        )
        return Decision(Action.WITHOUT, self._inputs)
