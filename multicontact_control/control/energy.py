"""A passivity observer of one contact, and the damping it may ask for."""

from __future__ import annotations

import math

from multicontact_control.config import ContactStateConfig


class PassivityObserver:
    """
    Watches the energy that a contact takes up beyond what it stores.

    The robot does the work W = sum alpha v h on a surface, of which alpha^2 / (2 k) is stored in
    it. What remains is turned into heat there, and a controller that keeps on delivering it feeds
    a bouncing or an oscillation. The remainder is forgotten with a time constant; above a limit
    the contact counts as active, and a damping force b v is to be taken from its command.

    Parameters
    ----------
    config
        Limit, memory and injected damping b.
    stiffness
        Modelled stiffness k of the contact [N/m].
    period
        h [s].

    Attributes
    ----------
    energy
        Work not stored and not yet forgotten [J].
    limit
        Its bound [J].

    """

    def __init__(self, config: ContactStateConfig, stiffness: float, period: float) -> None:
        self._stiffness, self._period = stiffness, period
        self._keep = math.exp(-period / config.energy_memory)
        self._damping = config.injected_damping
        self.limit = config.energy_limit
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.energy = 0.0
        self._stored = 0.0

    @property
    def passive(self) -> bool:
        """Whether the bound is kept."""
        return self.energy <= self.limit

    def update(self, alpha: float, speed: float) -> float:
        """
        Take in one tick.

        Parameters
        ----------
        alpha
            Measured force [N].
        speed
            Speed of the contact point along the normal INTO the surface [m/s].

        Returns
        -------
        float
            Force to take from the command [N], 0 while the bound is kept.

        """
        stored = max(alpha, 0.0) ** 2 / (2.0 * self._stiffness)
        work = alpha * speed * self._period
        self.energy = self._keep * self.energy + work - (stored - self._stored)
        self._stored = stored
        return 0.0 if self.passive else self._damping * speed
