"""Limits of what may be commanded; what is beyond them is refused, not bent."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from multicontact_control.arrays import Vector
from multicontact_control.config import Config, ControllerConfig, LimitsConfig, parameter, Real
from multicontact_control.config.contact import LARGEST_OFFSET
from multicontact_control.errors import CommandError

START_EXCESS = 1e-3  # m or rad beyond a limit, from where control may start all the same


class CommandLimits(Config):
    """Largest force that may be commanded, and more; the box for positions is that of `limits`."""

    force_ceiling: Real = parameter(
        30.0, 'Largest force that may be commanded at a contact; below '
        'contact_state.force_ceiling, at which a contact is left.', unit='N', live=True, gt=0.0)
    motion_timeout: Real = parameter(
        0.2, 'How long twist and acceleration of a motion command count if no other follows; then '
        'only its pose does.', unit='s', live=True, gt=0.0)

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


def half_lengths(config: ControllerConfig) -> dict[str, float]:
    """Return what the centre of pressure that a couple stands for moves along, by couple [m]."""
    return {column.name: column.half_length for column in config.columns
            if column.half_length > 0.0}


def offset_shares(
    halves: Mapping[str, float], centres: Mapping[str, float],
) -> dict[str, float]:
    """
    Return the couples, relative to the normal forces, that centres of pressure ask for.

    `centres` are from the middle of a contact, by the couple's name [m]; a name that is not that
    of a couple (`half_lengths`) is a CommandError.
    """
    for name in centres:
        if name not in halves:
            raise CommandError('centre of pressure', f'one of {", ".join(halves)}'
                               if halves else 'an edge or plane', f"'{name}'")
    return {name: centre / halves[name] for name, centre in centres.items()}


def check_offsets(
    config: ControllerConfig, forces: Mapping[str, float], shares: Mapping[str, float],
) -> None:
    """
    Refuse a centre of pressure outside its contact.

    Parameters
    ----------
    config
        Contacts.
    forces
        Of contacts, and couples, by name [N].
    shares
        Couples relative to the normal forces, by name, in place of these.

    Raises
    ------
    CommandError
        Naming the couple.

    """
    columns = config.columns
    for column in columns:
        pressed = forces.get(columns[column.leader].name, 0.0)
        if column.half_length == 0.0 or pressed == 0.0:
            continue
        share = shares.get(column.name, forces.get(column.name, 0.0) / pressed)
        if not abs(share) <= LARGEST_OFFSET + 1e-9:
            raise CommandError(
                f'centre of pressure of {column.name}',
                f'at most {LARGEST_OFFSET * column.half_length:.3g} m from the middle',
                f'{share * column.half_length:.3g} m')


def check_position(position_world: Vector, limits: LimitsConfig) -> None:
    """Refuse a position outside the workspace box, if any: CommandError names the axis."""
    for axis, x, lower, upper in zip(
            'xyz', position_world, limits.workspace_lower, limits.workspace_upper):
        if not lower <= x <= upper:
            raise CommandError(f'position {axis}', f'{lower:g} to {upper:g} m', f'{x:g} m')


def outside_limits(
    config: ControllerConfig, q: Vector, position_world: Vector,
) -> tuple[str, ...]:
    """Return where joints q [rad] and the operational point [m] are beyond limits, a line each."""
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
