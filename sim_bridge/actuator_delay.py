"""The delay between a sample and the torque that answers it, counted in control periods."""

from __future__ import annotations

from multicontact_control.arrays import require_shape, Vector
import numpy as np


class ActuatorDelay:
    """
    Commands that each act a fixed number of ticks after the sample they answer.

    With 0 ticks a command acts in the period that begins with its own sample. Before any command
    does, the `initial` torque acts, shape (n,) [N m].
    """

    def __init__(self, ticks: int, initial: Vector) -> None:
        self._ticks = ticks
        self._held: Vector = np.array(initial, dtype=float)
        self._commands: dict[int, Vector] = {}

    def command(self, tick: int, torque: Vector) -> None:
        """Enter the command that answers sample `tick`, shape (n,) [N m]; the last one holds."""
        require_shape('torque', torque, self._held.shape)
        self._commands[tick] = np.array(torque, dtype=float)

    def torque_for(self, tick: int) -> Vector:
        """
        Return the torque that acts from `tick` to `tick` + 1; ask once per period, in order.

        The command for sample `tick` - `ticks`, or the newest one before it, shape (n,) [N m].
        """
        for sample in sorted(x for x in self._commands if x <= tick - self._ticks):
            self._held = self._commands.pop(sample)
        return self._held.copy()
