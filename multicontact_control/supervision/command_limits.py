"""Limits of what may be commanded; what is beyond them is refused, not bent."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from multicontact_control.arrays import Vector
from multicontact_control.config import Config, ControllerConfig, LimitsConfig, parameter, Real
from multicontact_control.errors import CommandError

START_EXCESS = 1e-3  # m or rad beyond a limit, from where control may start all the same


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


def outside_limits(
    config: ControllerConfig, q: Vector, position_world: Vector,
) -> tuple[str, ...]:
    """
    Return where an arm is beyond its limits, a line for each.

    Parameters
    ----------
    config
        Box and stops.
    q
        Joint positions, shape (n,) [rad].
    position_world
        Of the operational point, shape (3,) [m].

    """
    limits = config.limits
    bounds = [
        (f'operational point: expected {axis} in', x, lower, upper, 'm', 'workspace')
        for axis, x, lower, upper in zip(
            'xyz', position_world, limits.workspace_lower, limits.workspace_upper)]
    bounds += [
        (f'{name}: expected', x, lower, upper, 'rad', 'joint') for name, x, lower, upper in zip(
            config.robot.joint_names, q, limits.joint_lower, limits.joint_upper)]
    return tuple(
        f'{what} {lower:g} to {upper:g} {unit} (limits.{kind}_lower, limits.{kind}_upper), found '
        f'{x:.4g} {unit}' for what, x, lower, upper, unit, kind in bounds
        if not lower - START_EXCESS <= x <= upper + START_EXCESS)
