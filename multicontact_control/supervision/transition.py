"""From the torque that acts to the one that is to act, without a jump: two blends in a row."""

from __future__ import annotations

from collections.abc import Callable
import math

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig, TransitionConfig
from multicontact_control.quintic import quintic
import numpy as np

STEEPEST = 1.875  # largest slope of the quintic from 0 to 1
BLEND_TIME = 0.003  # s, time constant by which a change of active contacts or laws is blended


class QuinticBlend:
    """
    Adds to a law what it lacked of the torque at its start, and lets that fade.

    The law acts with all its gain from the first tick on; only the difference fades, by the
    `quintic`, in `blend_time` or longer if `torque_rate` demands it.

    Parameters
    ----------
    config
        How fast.
    period
        Control period [s].

    """

    def __init__(self, config: TransitionConfig, period: float) -> None:
        self.config = config
        self._period = period
        self._from: Vector | None = None
        self._difference: Vector | None = None
        self._tick = self._ticks = 0

    @property
    def idle(self) -> bool:
        """Whether the next answer is the law's own."""
        return self._from is None and self._difference is None

    def start(self, torque: Vector) -> None:
        """Let the next answer be the torque that acts now, shape (n,) [N m]."""
        self._from = np.array(torque, dtype=float)

    def cancel(self) -> None:
        """Drop what is left of the difference at once; the caller handles the jump."""
        self._from = self._difference = None

    def apply(self, torque: Vector) -> Vector:
        """Return what to command, shape (n,) [N m]: the law's very object once all has faded."""
        if self._from is not None:
            return self._first(self._from, torque)
        if self._difference is None:
            return torque
        self._tick += 1
        if self._tick >= self._ticks:
            self._difference = None
            return torque
        faded, _, _ = quintic(self._tick, self._ticks)
        blended: Vector = torque + (1.0 - faded) * self._difference
        return blended

    def _first(self, start: Vector, torque: Vector) -> Vector:
        difference = start - torque
        largest = float(np.abs(difference).max())
        if not math.isfinite(largest):
            return torque  # for the caller to refuse; the start waits for a law that is one
        duration = max(self.config.blend_time, STEEPEST * largest / self.config.torque_rate)
        self._from, self._difference = None, difference
        self._tick, self._ticks = 0, math.ceil(duration / self._period)
        return start


class ExponentialBlend:
    """
    Hands over between laws without a step.

    At a switch the difference between the last command and the new law's is kept as an offset
    that decays exponentially: the torque, and with it the commanded acceleration, is continuous,
    and changes by at most |offset| h / time_constant per period more than the new law's own.

    Parameters
    ----------
    time_constant
        Of that decay [s].
    period
        h [s].

    """

    def __init__(self, time_constant: float, period: float) -> None:
        self._keep = math.exp(-period / time_constant)
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next law starts at once."""
        self._law: object = None
        self.cancel()

    def cancel(self) -> None:
        """Drop the offset at once; the caller handles the jump."""
        self._offset: Vector | None = None

    def settled(self, law: object) -> bool:
        """Return whether the next answer is the law's own if it is this law's."""
        return self._offset is None and law == self._law

    def apply(self, law: object, torque: Vector, last: Vector | None) -> Vector:
        """Return what to command, shape (n,) [N m]; `last` acts now, None before the first."""
        if last is not None and law != self._law:
            self._offset = last - torque
        elif self._offset is not None:
            self._offset = self._offset * self._keep
            if np.abs(self._offset).max() < 1e-6:
                self._offset = None
        self._law = law
        return torque if self._offset is None else torque + self._offset


class TorqueTransition:
    """
    Two blends in a row, each with its own pace.

    What is commanded (a start, other gains, a hold) goes over as `transition` says, which
    may take a second. What happens by itself (a contact that comes or goes, a reaction) goes over
    within `BLEND_TIME`; a reaction ends the slow one. Where there is only one law, the fast one
    has nothing to do. Torques are of shape (n,) [N m].

    Parameters
    ----------
    config
        The slow pace.

    """

    def __init__(self, config: ControllerConfig) -> None:
        self._fast = ExponentialBlend(BLEND_TIME, config.period)
        self._slow = QuinticBlend(config.transition, config.period)
        self._last: Vector | None = None

    def adopt(self, config: ControllerConfig) -> None:
        """Take the slow pace of another configuration."""
        self._slow.config = config.transition

    def reset(self) -> None:
        """Forget the past."""
        self._last = None
        self._fast.reset()
        self._slow.cancel()

    def allow_for(self, change: Vector) -> None:
        """Take note that what the drives add to a command has changed."""
        if self._last is not None:
            self._last = self._last + change

    @property
    def begun(self) -> bool:
        """Whether anything has been commanded so far."""
        return self._last is not None

    def settled(self, law: object) -> bool:
        """Return whether nothing has to go over any more, as long as this law acts."""
        return self._last is not None and self._slow.idle and self._fast.settled(law)

    def restart_from_last(self) -> None:
        """Let the next command be the last one again, if there was one."""
        if self._last is not None:
            self._fast.cancel()
            self._slow.start(self._last)

    def begin(self, held: Callable[[], Vector]) -> None:
        """Let the next command be the torque that acts: `held()` if none was commanded so far."""
        if self._last is None:
            self._slow.start(held())
        else:
            self.restart_from_last()

    def drop_slow_blend(self, held: Callable[[], Vector]) -> None:
        """Leave what has still to go over slowly to the fast blend; see `begin`."""
        if self._last is None:
            self._last = held()
        if not self._slow.idle:
            self._fast.reset()
        self._slow.cancel()

    def apply(self, law: object, torque: Vector) -> Vector:
        """
        Return the torque to command, the same object if nothing has to go over any more.

        `law` is anything that differs from one law to another.
        """
        return self._fast.apply(law, self._slow.apply(torque), self._last)

    def commanded(self, torque: Vector) -> None:
        """Take note of the torque that acts now."""
        self._last = torque
