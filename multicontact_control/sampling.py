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
    """What the control loop does now; `SampleTiming` says when."""

    WAIT = 'wait: there is nothing to do yet'
    STEP = 'step by a whole sample'
    STEP_ANEW = 'forget the past, then step by a whole sample'
    STEP_BY_HALF = 'step by half a sample'
    STEP_WITHOUT_SAMPLE = 'step without a sample'
    REPEAT_TORQUE = 'send the newest torque again, as the answer to this sample'
    PUBLISH_AGAIN = 'publish the last tick again, for the estimator that missed it'
    REFUSE = 'refuse the sample: it is older than the last'


class Decision(NamedTuple):
    """What the control loop does now, and the inputs of the tick if it is a step."""

    action: Action
    inputs: TickInputs | None = None


class Sample(NamedTuple):
    """A sample that waits for its tick; a half that has not come is None."""

    stamp: int  # ns
    joints: JointInput | None
    wrench: WrenchInput | None


class SampleTiming:
    """
    Pairs the readings of one time, and decides what each message, or its absence, leads to.

    If `supervised`, a supervisor is around the law and answers what is missing; bare, the law is
    alone and waits for whole samples. In lockstep each step waits for the noise variance R of the
    sample before, so that a simulation gives the same numbers again.

    ================================== =================== ============= ==================
    What has come                      supervised          bare          lockstep
    ================================== =================== ============= ==================
    one half of a sample               WAIT                WAIT          WAIT
    both, within `pair_tolerance`      STEP                STEP          STEP with R [1]_
    the same stamp again, answered     REPEAT_TORQUE       REPEAT_TORQUE REPEAT_TORQUE
    the same stamp again, waiting      -                   -             PUBLISH_AGAIN
    one sample older than the last     REFUSE              STEP_ANEW     STEP_ANEW
    a second, not older than the first STEP [2]_           as above [3]_ as above [3]_
    no sample for `patience`           STEP_BY_HALF if     WAIT          WAIT
                                       one half waits
    none one period later, or later    STEP_WITHOUT_SAMPLE WAIT          WAIT
                                       [4]_
    ================================== =================== ============= ==================

    Nothing is missing before the first sample. The time of a tick is its stamp less the first;
    bare, the law's time goes in whole periods.

    A robot that waits for the answer to its sample, and publishes the sample again until it has
    that, gets it: every answer has the stamp of the newest sample, also after steps without one.

    .. [1] Of the sample before; WAIT until it is there. The supervisor's safe behaviour does not
       wait for it.
    .. [2] The clock was set back; the watchdog answers that.
    .. [3] The first has become the last sample: STEP, or REPEAT_TORQUE for the same stamp.
    .. [4] The first one counts on all periods since the newest sample, each later one those since
       the one before. Time does not go back when samples come again: their stamps are shifted from
       then on, and `TickInputs.ahead` says by how much.

    Parameters
    ----------
    rate, supervised, lockstep, has_wrench
        1 / h [Hz]; whether a supervisor is around the law, R is waited for, and there is a wrist
        sensor, without which joint states alone are whole samples.
    patience, pair_tolerance
        How long the next sample is waited for, 0 for ever, and the largest difference between
        the stamps of a pair [periods].

    Attributes
    ----------
    last_stamp
        Stamp of the newest sample [ns], -1 before the first.
    answered_stamp
        Stamp that the next command carries [ns]: `last_stamp`, plus the periods counted on since.
    tick
        `last_stamp` less the first stamp, in periods; negative after a clock was set back.
    variance, silence_deadline
        The newest R, shape (r,) [N^2], or None; the monotonic time from which on
        `decide_on_silence` has something to decide [ns], 0 for never.
    unpaired, skipped, stamp_difference, tolerance
        Readings without their other half; samples that never came or were overtaken; by how much
        the stamps of the newest two readings differ, 0 once they pair, and may in a pair [ns].

    """

    def __init__(
        self,
        rate: float,
        *,
        supervised: bool = True,
        lockstep: bool = False,
        has_wrench: bool = True,
        patience: float = 0.0,
        pair_tolerance: float = 0.0,
    ) -> None:
        self._rate = rate
        self._period = 1.0 / rate
        self._period_ns = self._period * NANOSECONDS
        self._supervised = supervised
        self._lockstep = lockstep
        self._has_wrench = has_wrench
        self._patience_ns = 0.0
        if supervised and not lockstep:
            self._patience_ns = patience * self._period_ns
        self.tolerance = round(pair_tolerance * self._period_ns)
        self._halves: dict[type, Any] = {}  # the newest readings that have no pair
        self._waiting: Sample | None = None
        self._came_again = False
        self.unpaired = 0
        self.stamp_difference = 0
        self.restart()

    def restart(self) -> None:
        """
        Forget the past: the next sample is the first.

        In lockstep a sample that waits for its R stays.
        """
        if not self._lockstep:
            self._waiting = None  # it may be old
        self._first_stamp: int | None = None
        # Of the newest refused sample; one not older than it proves a clock set back.
        self._older_stamp: int | None = None
        self.last_stamp = -1
        self.answered_stamp = -1
        self._variance_stamp = -1
        self.variance: Vector | None = None
        self._inputs = TickInputs(0.0)
        self._time = 0.0  # of the newest tick [s]
        self._shift = 0.0  # of the stamps, by the ticks without a sample [s]
        self._last_arrival = 0.0  # monotonic time at which the newest sample came [ns]
        self._ticks_without_sample = 0  # since the newest one
        self._half_answered = False  # whether the newest sample came as one half
        self.tick = 0
        self.skipped = 0
        self.silence_deadline = 0

    def add_reading(self, reading: JointInput | WrenchInput) -> None:
        """
        Take in a reading; with its other half it is a sample that waits for its tick.

        A reading whose other half never came is counted as unpaired.
        """
        self.unpaired += type(reading) in self._halves
        self._halves[type(reading)] = reading
        joints = self._halves.get(JointInput)
        wrench = self._halves.get(WrenchInput)
        if joints is None or not self._is_whole(joints, wrench):
            return
        self.stamp_difference = 0
        if wrench is not None:
            self.stamp_difference = wrench.stamp - joints.stamp
        if abs(self.stamp_difference) <= self.tolerance:
            waiting = self._waiting
            self._came_again = waiting is not None and waiting.stamp == joints.stamp
            self._waiting = Sample(joints.stamp, joints, wrench)
            self._halves = {}
            self.stamp_difference = 0

    def _is_whole(self, joints: Any, wrench: Any) -> bool:
        """Return whether readings, each None where it is missing, are a whole sample."""
        return joints is not None and (wrench is not None or not self._has_wrench)

    def add_noise_variance(self, stamp: int, variance: Vector) -> None:
        """Use an R [N^2] from the next tick on; its stamp is that of a sample [ns]."""
        if stamp > self.last_stamp:
            return  # no sample so new has been answered: this R is from before a restart
        self._variance_stamp = stamp
        self.variance = variance
        time = self._seconds_since_first(stamp) + self._shift
        self._inputs = self._inputs._replace(variance=VarianceInput(time, variance))

    def _seconds_since_first(self, stamp: int) -> float:
        """Return the time of a stamp [ns] since the first sample, or since 0 before it [s]."""
        return (stamp - (self._first_stamp or 0)) * 1e-9

    def decide_on_message(self, now: float, *, safe: bool = False) -> Decision:
        """
        Decide after a message that came `now` [ns], in the safe behaviour if `safe`.

        A sample that waits is answered, repeated, refused or waits on, as the table says.
        """
        if self._waiting is None:
            return Decision(Action.WAIT)
        stamp, joints, wrench = self._waiting
        came_again = self._came_again
        self._came_again = False
        if self._is_answered(stamp):
            self._waiting = None
            self.answered_stamp = stamp
            return Decision(Action.REPEAT_TORQUE)
        action = Action.STEP
        if stamp < self.last_stamp:
            if self._lockstep or not self._supervised:
                # A simulation has begun again, or no watchdog answers a clock that was set back.
                self.restart()
                action = Action.STEP_ANEW
            elif self._older_stamp is None or stamp < self._older_stamp:
                self._older_stamp = stamp
                self._waiting = None
                return Decision(Action.REFUSE)
        elif self._lockstep and not safe and self._variance_stamp != self.last_stamp:
            if came_again:
                return Decision(Action.PUBLISH_AGAIN)
            return Decision(Action.WAIT)
        self._waiting = None
        self._older_stamp = None
        self._half_answered = not self._is_whole(joints, wrench)
        self._take_stamp(stamp, now)
        newest_joints = self._inputs.joints
        if joints:
            newest_joints = joints._replace(stamp=self._time)
        newest_wrench = self._inputs.wrench
        if wrench:
            newest_wrench = wrench._replace(stamp=self._time)
        time = self._time
        if not self._supervised:
            time = self.tick * self._period
        variance = self._inputs.variance
        self._inputs = TickInputs(
            time, newest_joints, newest_wrench, variance, self._shift
        )
        return Decision(action, self._inputs)

    def _is_answered(self, stamp: int) -> bool:
        """Return whether a sample [ns] is the newest one again, or its other half."""
        if self._half_answered and self.last_stamp >= 0:
            return abs(stamp - self.last_stamp) <= self.tolerance
        return stamp == self.last_stamp

    def _take_stamp(self, stamp: int, now: float) -> None:
        """Go on to the tick of a sample [ns] that came `now` [ns]."""
        if self._first_stamp is None:
            self._first_stamp = stamp
        elapsed = self._seconds_since_first(stamp)
        tick = round(elapsed * self._rate)
        missed = tick - self.tick - 1
        if 0 < missed <= LONGEST_PAUSE * self._rate:
            self.skipped += missed
        time = elapsed + self._shift
        if self._ticks_without_sample and time <= self._time:
            self._shift += self._time + self._period - time
            time = self._time + self._period
        self.tick = tick
        self.last_stamp = stamp
        self.answered_stamp = stamp
        self._time = time
        self._last_arrival = now
        self._ticks_without_sample = 0
        self.silence_deadline = 0
        if self._patience_ns:
            self.silence_deadline = int(now + self._patience_ns)

    def decide_on_silence(self, now: int) -> Decision:
        """
        Decide if the deadline has passed `now` [ns] and all that has come is taken in.

        Half a sample that waits is used; without one, time is counted on for each period.
        """
        if not 0 < self.silence_deadline <= now:
            return Decision(Action.WAIT)
        newest = max(self._halves.values(), key=lambda half: half.stamp, default=None)
        if newest is not None and newest.stamp > self.last_stamp + self.tolerance:
            return self._step_by_half(newest, now)
        silence = now - self._last_arrival
        periods_late = int((silence - self._patience_ns) // self._period_ns)
        periods_passed = 0  # since the newest sample
        if periods_late:  # what is only late is waited for one more period
            periods_passed = int(silence // self._period_ns)
        new_periods = periods_passed - self._ticks_without_sample
        self._ticks_without_sample = periods_passed
        deadline = self._last_arrival + self._patience_ns
        deadline += (periods_late + 1) * self._period_ns
        self.silence_deadline = int(deadline)
        if not new_periods:
            return Decision(Action.WAIT)
        self.answered_stamp = self.last_stamp + round(
            periods_passed * self._period * NANOSECONDS
        )
        counted_on = new_periods * self._period
        self._time += counted_on
        self._inputs = self._inputs._replace(
            time=self._time, ahead=self._inputs.ahead + counted_on
        )
        return Decision(Action.STEP_WITHOUT_SAMPLE, self._inputs)

    def _step_by_half(self, reading: Any, now: int) -> Decision:
        """Step by the half of a sample whose other half has not come `now` [ns]."""
        kind = type(reading)
        del self._halves[kind]
        self.unpaired += 1
        if kind is JointInput:
            self._waiting = Sample(reading.stamp, reading, None)
        else:
            self._waiting = Sample(reading.stamp, None, reading)
        earliest = self._last_arrival + self._period_ns
        # Taken to have come on the grid of the samples, a period after the last, so that the next
        # deadline does not slip; after a longer silence, a period ago.
        nominal_arrival = max(earliest, now - self._period_ns)
        decision = self.decide_on_message(nominal_arrival)
        return Decision(Action.STEP_BY_HALF, decision.inputs)
