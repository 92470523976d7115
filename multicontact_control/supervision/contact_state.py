"""
The state of each contact: looked for, touched, held, lost, given up.

One machine per contact decides which law drives the operational point along that contact's
normal: the force law from touch to loss, the motion law before and after. In the motion law the
tip advances along the normal by a displacement that is ramped, bounded and braked. What a
machine does is in `contact_kernels`, compiled.
"""

from __future__ import annotations

from enum import Enum
import math
from typing import Any

from multicontact_control.config import ContactStateConfig
from multicontact_control.supervision.contact_kernels import (
    advance_one,
    APPROACHING,
    CONTACT,
    CONTACT_SETTINGS,
    FREE,
    GIVEN_UP,
    HOLDING,
    IMPACT,
    let_one_go,
    LOST,
    RETRACTING,
)
import numpy as np
from numpy.typing import NDArray

Records = NDArray[np.void]


class ContactState(Enum):
    """What is known of a contact."""

    FREE = 'free'
    APPROACHING = 'approaching'
    IMPACT = 'impact'
    HOLDING = 'holding'
    LOST = 'lost'
    RETRACTING = 'retracting'
    GIVEN_UP = 'given up'


STATES = {
    FREE: ContactState.FREE, APPROACHING: ContactState.APPROACHING, IMPACT: ContactState.IMPACT,
    HOLDING: ContactState.HOLDING, LOST: ContactState.LOST, RETRACTING: ContactState.RETRACTING,
    GIVEN_UP: ContactState.GIVEN_UP}
ACTIVE = (ContactState.IMPACT, ContactState.HOLDING)


def contact_settings(config: ContactStateConfig, period: float) -> Records:
    """Return what compiled code needs of a configuration: one record of `CONTACT_SETTINGS`."""
    others = {'period': period, 'energy_keep': math.exp(-period / config.energy_memory)}
    settings = np.zeros(1, dtype=CONTACT_SETTINGS)
    for name in settings.dtype.names or ():
        settings[name] = others[name] if name in others else getattr(config, name)
    return settings


class ContactMachine:
    """
    The state machine of one contact.

    free -> approaching -> impact -> holding -> lost -> approaching ..., given up once the tip has
    gone too far without a surface, retracting (then given up) beyond the force ceiling. Touch
    and loss have thresholds apart and least times, so that a bounce or a spike changes nothing.

    Parameters
    ----------
    config
        Thresholds, times, speeds.
    period
        h [s].
    memory
        One record of `CONTACT` to keep everything in; its own if there is none.
    stiffness
        Modelled stiffness of the surface, by which a tip is in it while it presses [N/m].

    """

    def __init__(
        self, config: ContactStateConfig, period: float, memory: Records | None = None,
        stiffness: float = math.inf,
    ) -> None:
        self._settings = contact_settings(config, period)
        self._memory: Any = np.zeros(1, dtype=CONTACT) if memory is None else memory
        self._memory['stiffness'] = stiffness
        let_one_go(self._memory, 0.0, 0.0)  # no tick is to wait for numba
        self.reset()

    def reset(self) -> None:
        """Start anew, free."""
        for name in ('state', 'losses', 'displacement', 'speed', 'acceleration', 'force_limit',
                     'in_state', 'below', 'level', 'start', 'target'):
            self._memory[name] = 0
        self._memory['origin'] = math.nan  # where the surface was, if it was ever met

    @property
    def state(self) -> ContactState:
        """Present state."""
        return STATES[int(self._memory['state'][0])]

    @property
    def active(self) -> bool:
        """Whether the force law drives this contact."""
        return self.state in ACTIVE

    @property
    def displacement(self) -> float:
        """How far the motion law is to be along the normal, relative to the task [m]."""
        return float(self._memory['displacement'][0])

    @property
    def speed(self) -> float:
        """Speed of that displacement [m/s]."""
        return float(self._memory['speed'][0])

    @property
    def acceleration(self) -> float:
        """Acceleration of that displacement [m/s^2]."""
        return float(self._memory['acceleration'][0])

    @property
    def force_limit(self) -> float:
        """Upper limit of the desired force in this tick [N]."""
        return float(self._memory['force_limit'][0])

    @property
    def losses(self) -> int:
        """How often the contact was lost since it was first wanted."""
        return int(self._memory['losses'][0])

    def retry(self) -> None:
        """Look again for a surface that was given up."""
        if self.state is ContactState.GIVEN_UP:
            self._memory['state'] = FREE
            self._memory['in_state'] = 0.0
            self._memory['origin'] = math.nan

    def let_go(self, place: float, speed: float = 0.0) -> None:
        """
        Give a contact back to the motion law, from where the tip is.

        Parameters
        ----------
        place, speed
            Of the tip along the normal, relative to the task [m, m/s].

        """
        let_one_go(self._memory, place, speed)

    def update(self, wanted: bool, alpha: float, alpha_des: float, place: float,
               speed: float) -> None:
        """
        Take in one tick.

        Parameters
        ----------
        wanted
            Whether the task asks for this contact.
        alpha, alpha_des
            Measured and asked for force [N].
        place, speed
            Of the tip along the normal, relative to the task without displacement [m, m/s].

        """
        advance_one(self._memory, self._settings, wanted, alpha, alpha_des, place, speed)
