"""The delay between a sample and the torque that answers it, counted in control periods."""

from __future__ import annotations

from multicontact_control.arrays import require_shape, Vector
import numpy as np


class ActuatorDelay:
    """
    A line of commands, each acting a fixed number of ticks after the sample it answers.

    Parameters
    ----------
    ticks
        Control periods from a sample to the start of the period its command acts in; 0 lets a
        command act in the period that begins with its own sample.
    initial
        Torque that acts before any command does, shape (n,) [N m].

    Attributes
    ----------
    misses
        How many periods had to hold an older command because theirs was not there.

    """

    def __init__(self, ticks: int, initial: Vector) -> None:
        self._ticks = ticks
        self._held: Vector = np.array(initial, dtype=float)
        self._held_tick = -1
        self._commands: dict[int, Vector] = {}
        self.misses = 0

    def command(self, tick: int, torque: Vector) -> None:
        """
        Enter the command that answers sample `tick`; a later one for it takes its place.

        Parameters
        ----------
        tick
            Index of the sample.
        torque
            Joint torque, shape (n,) [N m].

        """
        require_shape('torque', torque, self._held.shape)
        self._commands[tick] = np.array(torque, dtype=float)

    def missing(self, tick: int) -> bool:
        """Return whether the period from `tick` on has no command of its own yet."""
        wanted = tick - self._ticks
        return wanted >= 0 and wanted not in self._commands

    def torque_for(self, tick: int) -> Vector:
        """
        Return the torque that acts from `tick` to `tick` + 1; ask once per period, in order.

        Parameters
        ----------
        tick
            Index of the sample the period begins with.

        Returns
        -------
        Vector
            The command for sample `tick` - `ticks`, or, if that is not there, the newest one
            that came before it, shape (n,) [N m].

        """
        if self.missing(tick):
            self.misses += 1
        for known in [known for known in self._commands if known <= tick - self._ticks]:
            torque = self._commands.pop(known)
            if known >= self._held_tick:
                self._held, self._held_tick = torque, known
        return self._held.copy()
