"""From the torque that acts to the one that is to act: at a start, a switch of laws, a change."""

from __future__ import annotations

from collections.abc import Callable

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.supervision.fallback import TorqueBlend as SwitchBlend
from multicontact_control.supervision.torque_blend import TorqueBlend


class TorqueTransition:
    """
    Two blends in a row, each with its own pace.

    What somebody asks for (a start, other gains, a hold) goes over as `transition` says, which
    may take a second. What happens by itself (a contact that comes or goes, a reaction) goes over
    within `contact_state.blend_time`, a few milliseconds; a reaction ends the slow one.

    Parameters
    ----------
    config
        Both paces.

    """

    def __init__(self, config: ControllerConfig) -> None:
        self._fast = SwitchBlend(config.contact_state.blend_time, config.period)
        self._slow = TorqueBlend(config.transition, config.period)

    def adopt(self, config: ControllerConfig) -> None:
        """Take the slow pace of another configuration."""
        self._slow.config = config.transition

    def reset(self) -> None:
        """Forget the past."""
        self._fast.reset()
        self._slow.cancel()

    @property
    def begun(self) -> bool:
        """Whether anything has been commanded so far."""
        return self._fast.last is not None

    def restart_from_last(self) -> None:
        """Let the next command be the last one again, if there was one."""
        if self._fast.last is not None:
            self._fast.settle()
            self._slow.start(self._fast.last)

    def begin(self, held: Callable[[], Vector]) -> None:
        """
        Let the next command be the torque that acts now.

        Parameters
        ----------
        held
            Returns it if nothing has been commanded so far, shape (n,) [N m].

        """
        if self._fast.last is None:
            self._slow.start(held())
        else:
            self.restart_from_last()

    def drop_slow_blend(self, held: Callable[[], Vector]) -> None:
        """Leave what has still to go over slowly to the fast blend; see `begin`."""
        if self._fast.last is None:
            self._fast.last = held()
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

        """
        return self._fast.apply(law, self._slow.apply(torque))

    def commanded(self, torque: Vector) -> None:
        """Take note of the torque that acts now, shape (n,) [N m]."""
        self._fast.last = torque
