"""The delay between a sample and the torque that answers it, counted in control periods."""

from __future__ import annotations

from multicontact_control.arrays import require_shape, Vector
import numpy as np


class ActuatorDelay:
    """
    Commands that each act a fixed number of ticks after the sample they answer.

    With 0 ticks a command acts in the period that begins with its own sample. Before any command
    does, the `initial` torque acts, shape (n,) [N m]. `misses` counts the periods that held an
    older command because theirs was not there.
    """

    def __init__(self, ticks: int, initial: Vector) -> None:
        self._ticks = ticks
        self._held: Vector = np.array(initial, dtype=float)
        self._newest = -1  # sample whose command is held
        self._commands: dict[int, Vector] = {}
        self.misses = 0

    def command(self, tick: int, torque: Vector) -> None:
        """Enter the command that answers sample `tick`, shape (n,) [N m]; the last one holds."""
        require_shape('torque', torque, self._held.shape)
        self._commands[tick] = np.array(torque, dtype=float)

    def missing(self, tick: int) -> bool:
        """Return whether the period from `tick` on has no command of its own yet."""
        return 0 <= tick - self._ticks and tick - self._ticks not in self._commands

    def torque_for(self, tick: int) -> Vector:
        """
        Return the torque that acts from `tick` to `tick` + 1; ask once per period, in order.

        The command for sample `tick` - `ticks`, or the newest one before it, shape (n,) [N m].
        """
        self.misses += self.missing(tick)
        known = [sample for sample in self._commands if sample <= tick - self._ticks]
        if known and max(known) >= self._newest:
            self._newest = max(known)
            self._held = self._commands[self._newest]
        for sample in known:
            del self._commands[sample]
        return self._held.copy()
