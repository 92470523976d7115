"""A passivity observer of one contact, and the damping it may ask for."""

from __future__ import annotations

from typing import Any

from multicontact_control.config import ContactStateConfig
from multicontact_control.supervision.contact_kernels import CONTACT, watch_energy_of_one
from multicontact_control.supervision.contact_state import contact_settings, Records
import numpy as np


class PassivityObserver:
    """
    Watches the energy that a contact takes up beyond what it stores.

    The robot does the work W = sum alpha v h on a surface, of which alpha^2 / (2 k) is stored in
    it. What remains is turned into heat there, and a controller that keeps on delivering it feeds
    a bouncing or an oscillation. The remainder is forgotten with a time constant; above a limit
    the contact counts as active, and a damping force b v is to be taken from its command. The
    arithmetic is in `contact_kernels`, compiled.

    Parameters
    ----------
    config
        Limit, memory and injected damping b.
    stiffness
        Modelled stiffness k of the contact [N/m].
    period
        h [s].
    memory
        One record of `CONTACT` to keep everything in; its own if there is none.

    Attributes
    ----------
    limit
        Bound of the energy [J].

    """

    def __init__(
        self, config: ContactStateConfig, stiffness: float, period: float,
        memory: Records | None = None,
    ) -> None:
        self._settings = contact_settings(config, period)
        self._memory: Any = np.zeros(1, dtype=CONTACT) if memory is None else memory
        self._memory['stiffness'] = stiffness
        self.limit = config.energy_limit
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._memory['energy'] = self._memory['stored'] = 0.0

    @property
    def energy(self) -> float:
        """Work not stored and not yet forgotten [J]."""
        return float(self._memory['energy'][0])

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
        return float(watch_energy_of_one(self._memory, self._settings, alpha, speed))
