"""Limits of what may be commanded; what is beyond them is refused, not bent."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from multicontact_control.arrays import Vector
from multicontact_control.config import Config, LimitsConfig, parameter, Real
from multicontact_control.errors import CommandError


class CommandLimits(Config):
    """Largest force that may be commanded; the box for positions is that of `limits`."""

    force_ceiling: Real = parameter(
        30.0, 'Largest force that may be commanded at a contact; below '
        'contact_state.force_ceiling, at which a contact is left.', unit='N', live=True, gt=0.0)

    def check_forces(
        self, forces: Mapping[str, float], smallest: float, couples: Collection[str] = (),
    ) -> None:
        """
        Refuse forces out of limits.

        Parameters
        ----------
        forces
            By contact, and couples [N].
        smallest
            `contact_state.smallest_force` [N]; 0 is allowed all the same, for no contact.
        couples
            Which names are those of couples, which may have either sign.

        Raises
        ------
        CommandError
            Naming the first contact.

        """
        for name, force in forces.items():
            if name in couples:
                if not abs(force) <= self.force_ceiling:
                    raise CommandError(f'couple {name}', f'at most {self.force_ceiling:g} N',
                                       f'{force:g} N')
            elif force != 0.0 and not smallest <= force <= self.force_ceiling:
                raise CommandError(
                    f'force on {name}', f'0 or {smallest:g} to {self.force_ceiling:g} N',
                    f'{force:g} N')


def check_position(position_world: Vector, limits: LimitsConfig) -> None:
    """
    Refuse a position outside the workspace box, if there is one.

    Raises
    ------
    CommandError
        Naming the axis.

    """
    for axis, x, lower, upper in zip(
            'xyz', position_world, limits.workspace_lower, limits.workspace_upper):
        if not lower <= x <= upper:
            raise CommandError(f'position {axis}', f'{lower:g} to {upper:g} m', f'{x:g} m')
