"""What the numbers of an action mean: forces, a twist, and the stiffness of the motion."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.config.contact import LARGEST_OFFSET
from multicontact_control.learning.config import EnvironmentConfig
from multicontact_control.supervision.command_limits import CommandLimits
import numpy as np

TWIST_NAMES = ('x', 'y', 'z', 'about x', 'about y', 'about z')
SOFTEST_SHARE = 1.0 / 16.0  # of the configured stiffness of the motion


class Wishes(NamedTuple):
    """What an action asks for; None where the scenario decides."""

    # Normal forces [N] and centres of pressure [m] by the names of forces and couples.
    forces: dict[str, float] | None
    centres: dict[str, float]
    twist_world: Vector | None  # [m/s, rad/s]
    natural_frequency: float | None  # of the motion [rad/s]


class ActionLayout:
    """
    Reads actions, whose numbers are in [-1, 1].

    Attributes
    ----------
    names
        What each number is.

    """

    def __init__(self, config: EnvironmentConfig, controller: ControllerConfig) -> None:
        self._controller = controller
        self._parts = config.actions
        self._twist_scale = np.repeat([config.speed, config.turn], 3)
        ceiling = controller.contact_state.force_ceiling
        self._largest_force = min(CommandLimits().force_ceiling, ceiling)
        counts = {'force': controller.column_names, 'motion': TWIST_NAMES}
        names: list[str] = []
        for part in config.actions:
            of_part = counts.get(part, ('natural frequency',))
            names += [f'{part} {name}' for name in of_part]
        self.names = tuple(names)

    def read_wishes(self, action: Vector) -> Wishes:
        """
        Return what an action asks for, shape (k,), of numbers in [-1, 1].

        A force goes from 0 to the largest that may be commanded, and lets the contact go below the
        smallest; a couple is a centre of pressure, a twist goes by the declared speeds; the motion
        has from a sixteenth to all of its configured stiffness.
        """
        forces = None
        centres: dict[str, float] = {}
        twist = None
        frequency = None
        rest = action
        for part in self._parts:
            if part == 'force':
                forces, centres = self._read_forces(rest)
                rest = rest[len(self._controller.columns) :]
            elif part == 'motion':
                twist = self._twist_scale * rest[:6]
                rest = rest[6:]
            else:
                share = SOFTEST_SHARE ** (0.5 * (1.0 - float(rest[0])))
                # The stiffness is the square of the frequency.
                frequency = self._controller.motion.natural_frequency * share**0.5
                rest = rest[1:]
        return Wishes(forces, centres, twist, frequency)

    def _read_forces(self, action: Vector) -> tuple[dict[str, float], dict[str, float]]:
        forces = {}
        centres = {}
        for column, number in zip(self._controller.columns, action.tolist()):
            if column.half_length:
                centres[column.name] = number * LARGEST_OFFSET * column.half_length
                continue
            force = 0.5 * (number + 1.0) * self._largest_force
            if force < self._controller.contact_state.smallest_force:
                force = 0.0
            forces[column.name] = force
        return forces, centres
