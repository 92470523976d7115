"""The delay between a sample and the torque that answers it, counted in control periods."""

from __future__ import annotations

from multicontact_control.arrays import require_shape, Vector
import numpy as np


class ActuatorDelay:
    """
    Commands that each act a fixed number of ticks after the sample they answer.

    With 0 ticks a command acts in the period that begins with its own sample.

    Parameters
    ----------
    ticks
        The delay in control periods.
    initial
        Torque that acts before any command does, shape (n,) [N m].

    """

    def __init__(self, ticks: int, initial: Vector) -> None:
        self._ticks = ticks
        self._acting: Vector = np.array(initial, dtype=float)
        self._commands: dict[int, Vector] = {}

    def enter_command(self, tick: int, torque: Vector) -> None:
        """Enter the command that answers sample `tick`, shape (n,) [N m]; the last one holds."""
        require_shape('torque', torque, self._acting.shape)
        self._commands[tick] = np.array(torque, dtype=float)

    def torque_for(self, tick: int) -> Vector:
        """
        Return the torque that acts from `tick` to `tick` + 1; ask once per period, in order.

        The command for sample `tick` - `ticks`, or the newest one before it, shape (n,) [N m].
        """
        newest = tick - self._ticks
        for sample in sorted(self._commands):
            if sample <= newest:
                self._acting = self._commands.pop(sample)
        return self._acting.copy()
