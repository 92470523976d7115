"""Limits of what may be commanded; a command beyond them is refused whole."""

from __future__ import annotations

from collections.abc import Mapping

from multicontact_control.arrays import Vector
from multicontact_control.config import (
    Config,
    ControllerConfig,
    LimitsConfig,
    parameter,
)
from multicontact_control.config.contact import LARGEST_OFFSET
from multicontact_control.control.tasks import MotionReading
from multicontact_control.control.trajectory_checks import AXES, check_position
from multicontact_control.errors import CommandError, ConfigError
import numpy as np

# Share of a speed beyond its limit, of a motion that is as fast as it may be.
SPEED_ROUNDING = 1e-6
# m or rad beyond a limit, from where control may start all the same.
START_EXCESS = 1e-3
SHARE_ROUNDING = 1e-9  # of a centre of pressure beyond its limit


class CommandLimits(Config):
    """Largest force that may be commanded, and more; the box for positions is that of `limits`."""

    force_ceiling: float = parameter(
        30.0,
        'Largest force that may be commanded at a contact; below '
        'contact_state.force_ceiling, at which a contact is left.',
        unit='N',
        live=True,
        gt=0.0,
    )
    motion_timeout: float = parameter(
        0.2,
        'How long twist and acceleration of a motion command count if no other follows; then '
        'only its pose does.',
        unit='s',
        live=True,
        gt=0.0,
    )

    def check(self, config: ControllerConfig) -> None:
        """Refuse, by ConfigError, a force that a contact is left for."""
        ceiling = config.contact_state.force_ceiling
        if not self.force_ceiling < ceiling:
            raise ConfigError(
                'command.force_ceiling',
                f'below contact_state.force_ceiling {ceiling:g} N',
                f'{self.force_ceiling:g} N',
            )

    def check_forces(
        self,
        config: ControllerConfig,
        forces: Mapping[str, float],
        before: Mapping[str, float],
        shares: Mapping[str, float],
    ) -> None:
        """
        Refuse, by CommandError, new forces and couples in place of those `before` [N], by name.

        `shares` are couples relative to the force of their contact.
        """
        ceiling = min(self.force_ceiling, config.contact_state.force_ceiling)
        columns = dict(zip(config.column_names, config.columns))
        for name, force in forces.items():
            if name not in columns:
                raise CommandError(
                    'contact', f'one of {", ".join(columns)}', f"'{name}'"
                )
            is_couple = columns[name].half_length > 0.0
            lowest = -ceiling if is_couple else config.contact_state.smallest_force
            if force != 0.0 and not lowest <= force <= ceiling:
                raise CommandError(
                    f'force on {name}',
                    f'0 or {lowest:g} to {ceiling:g} N',
                    f'{force:g} N',
                )
        commanded = {**before, **forces}
        for column in config.columns:
            pressed = commanded.get(config.columns[column.leader].name, 0.0)
            if column.half_length == 0.0 or pressed == 0.0:
                continue
            share = shares.get(column.name, commanded.get(column.name, 0.0) / pressed)
            if not abs(share) <= LARGEST_OFFSET + SHARE_ROUNDING:
                raise CommandError(
                    f'centre of pressure of {column.name}',
                    f'at most {LARGEST_OFFSET * column.half_length:.3g} m from the middle',
                    f'{share * column.half_length:.3g} m',
                )


def check_motion(motion: MotionReading, limits: LimitsConfig) -> None:
    """
    Refuse a motion of numbers that say nothing, or one beyond the limits, by CommandError.

    These are the workspace box, the speeds, and the accelerations.
    """
    check_position(motion.position_world, limits)
    finite = all(np.isfinite(part).all() for part in motion)
    if not (finite and np.any(motion.quaternion_xyzw)):
        raise CommandError(
            'motion',
            'finite numbers, and a quaternion that is not 0',
            [np.array(part).tolist() for part in motion],
        )
    check_twist(motion.twist_world, motion.acceleration_world, limits)


def check_twist(
    twist_world: Vector, acceleration_world: Vector, limits: LimitsConfig
) -> None:
    """
    Refuse a motion that is too fast, or becomes so too fast, by CommandError.

    Parameters
    ----------
    twist_world, acceleration_world
        Linear first, shape (6,) [m/s, rad/s], [m/s^2, rad/s^2].
    limits
        Those of the operational point.

    Raises
    ------
    CommandError
        That names the first speed or acceleration beyond its limit, and the limit's parameter.

    """
    linear = slice(0, 3)
    angular = slice(3, 6)
    for name, part, parameter_name, unit in (
        ('speed', twist_world[linear], 'operational_speed', 'm/s'),
        ('angular speed', twist_world[angular], 'operational_turn', 'rad/s'),
        (
            'acceleration',
            acceleration_world[linear],
            'operational_acceleration',
            'm/s^2',
        ),
        (
            'angular acceleration',
            acceleration_world[angular],
            'operational_turn_acceleration',
            'rad/s^2',
        ),
    ):
        size = float(np.linalg.norm(part))
        largest = getattr(limits, parameter_name)
        if not size <= largest * (1.0 + SPEED_ROUNDING):
            raise CommandError(
                name,
                f'at most {largest:g} {unit} (limits.{parameter_name})',
                f'{size:.3g} {unit}',
            )


def outside_limits(
    config: ControllerConfig,
    q: Vector,
    position_world: Vector,
) -> tuple[str, ...]:
    """Return where joints q [rad] and the operational point [m] are beyond limits, a line each."""
    lines = []
    for kind, names, values, unit in (
        ('workspace', AXES, position_world, 'm'),
        ('joint', config.robot.joint_names, q, 'rad'),
    ):
        lowest = getattr(config.limits, f'{kind}_lower')
        highest = getattr(config.limits, f'{kind}_upper')
        for name, value, lower, upper in zip(names, values, lowest, highest):
            if not lower - START_EXCESS <= value <= upper + START_EXCESS:
                lines.append(
                    f'{name}: expected {lower:g} to {upper:g} {unit} (limits.{kind}_lower, '
                    f'limits.{kind}_upper), got {value:.4g} {unit}'
                )
    return tuple(lines)
