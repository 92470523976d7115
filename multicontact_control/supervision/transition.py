"""From the torque that acts to the one that is to act: at a start, a switch of laws, a change."""

from __future__ import annotations

from collections.abc import Callable

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.supervision.torque_blend import ExponentialBlend, QuinticBlend


class TorqueTransition:
    """
    Two blends in a row, each with its own pace.

    What is commanded (a start, other gains, a hold) goes over as `transition` says, which
    may take a second. What happens by itself (a contact that comes or goes, a reaction) goes over
    within `contact_state.blend_time`, a few milliseconds; a reaction ends the slow one. Where
    there is only one law, the fast one has nothing to do.

    Parameters
    ----------
    config
        Both paces.

    """

    def __init__(self, config: ControllerConfig) -> None:
        self._fast = ExponentialBlend(config.contact_state.blend_time, config.period)
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
        """Take note that what the drives add to a command has changed, shape (n,) [N m]."""
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
        """
        Let the next command be the torque that acts now.

        Parameters
        ----------
        held
            Returns it if nothing has been commanded so far, shape (n,) [N m].

        """
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
        Return the torque to command.

        Parameters
        ----------
        law
            Anything that differs from one law to another.
        torque
            The law's torque, shape (n,) [N m].

        Returns
        -------
        Vector
            The same object if nothing has to go over any more, shape (n,) [N m].

        """
        return self._fast.apply(law, self._slow.apply(torque), self._last)

    def commanded(self, torque: Vector) -> None:
        """Take note of the torque that acts now, shape (n,) [N m]."""
        self._last = torque
