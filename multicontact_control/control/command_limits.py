"""Limits of what may be commanded; what is beyond them is refused, not bent."""

from __future__ import annotations

from collections.abc import Mapping

from multicontact_control.arrays import Vector
from multicontact_control.config import Config, parameter, Real, Vector3
from multicontact_control.errors import CommandError, ConfigError
from pydantic import model_validator


class CommandLimits(Config):
    """Largest force and the box of commanded positions."""

    force_ceiling: Real = parameter(
        30.0, 'Largest force that may be commanded at a contact.', unit='N', live=True, gt=0.0)
    workspace_lower: Vector3 = parameter(
        (-1.0, -1.0, -1.0), 'Lower corner of the box for commanded positions of the operational '
        'point, world axes.', unit='m', live=True)
    workspace_upper: Vector3 = parameter(
        (1.0, 1.0, 1.5), 'Upper corner of that box.', unit='m', live=True)

    @model_validator(mode='after')
    def _check_corners(self) -> CommandLimits:
        if any(a >= b for a, b in zip(self.workspace_lower, self.workspace_upper)):
            raise ConfigError(
                'command.workspace_lower', f'below workspace_upper {list(self.workspace_upper)}',
                list(self.workspace_lower))
        return self

    def check_forces(self, forces: Mapping[str, float]) -> None:
        """
        Refuse forces out of limits.

        Raises
        ------
        CommandError
            Naming the first contact.

        """
        for name, force in forces.items():
            if not 0.0 <= force <= self.force_ceiling:
                raise CommandError(
                    f'force on {name}', f'0 to {self.force_ceiling:g} N', f'{force:g} N')

    def check_position(self, position_world: Vector) -> None:
        """
        Refuse a position outside the box.

        Raises
        ------
        CommandError
            Naming the axis.

        """
        for axis, x, lower, upper in zip(
                'xyz', position_world, self.workspace_lower, self.workspace_upper):
            if not lower <= x <= upper:
                raise CommandError(f'position {axis}', f'{lower:g} to {upper:g} m', f'{x:g} m')
