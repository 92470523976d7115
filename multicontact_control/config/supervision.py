"""What surrounds the law: contact states, limits, valid inputs and reactions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from multicontact_control.config.base import Config, parameter, PositiveVector, Vector
from multicontact_control.errors import ConfigError

RELEASE_FORCE = 0.5  # N, measured force below which a contact may be lost


class ContactStateConfig(Config):
    """
    Thresholds of the contact states, and the search for surfaces.

    A contact is sought at a bounded speed, is touched by a change of force, holds, may be lost and
    is given up after a distance.
    """

    approach_speed: float = parameter(
        0.02,
        'Largest speed towards a surface that is not felt, where a scenario sets none.',
        unit='m/s',
        gt=0.0,
        le=0.25,
    )
    approach_ramp_time: float = parameter(
        0.5, 'Time to reach that speed.', unit='s', gt=0.0, le=10.0
    )
    approach_distance: float = parameter(
        0.1,
        'A surface not met over this distance is given up.',
        unit='m',
        gt=0.0,
        le=2.0,
    )
    contact_threshold: float = parameter(
        1.5,
        'Change of the measured force since the approach began that counts as touch.',
        unit='N',
        gt=RELEASE_FORCE,
        le=100.0,
    )
    retry_time: float = parameter(
        5.0,
        'Time to the next search for a contact that was not found; 0 for none.',
        unit='s',
        ge=0.0,
        le=3600.0,
    )
    smallest_force: float = parameter(
        3.0,
        'Smallest commanded force; below, sliding looks like a loss.',
        unit='N',
        gt=0.0,
    )
    preload: float = parameter(
        2.0,
        'Desired force from touch until the contact holds.',
        unit='N',
        gt=0.0,
        le=100.0,
    )
    force_ceiling: float = parameter(
        60.0, 'Measured force at which a contact is left.', unit='N', gt=0.0, le=1000.0
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        for lower, upper in (
            ('preload', 'force_ceiling'),
            ('contact_threshold', 'smallest_force'),
            ('contact_threshold', 'force_ceiling'),
        ):
            small = getattr(self, lower)
            large = getattr(self, upper)
            if not small < large:
                yield ConfigError(
                    f'contact_state.{lower}',
                    f'below {upper} {large:g} N',
                    f'{small:g} N',
                )


class LimitsConfig(Config):
    """
    Limits of commands and of motion; an empty list is no limit.

    Torques are kept within them in every tick; a motion that exceeds them is refused or bounded.
    """

    joint_lower: Vector = parameter((), 'Lower stop of each joint.', unit='rad')
    joint_upper: Vector = parameter((), 'Upper stop of each joint.', unit='rad')
    joint_speed: PositiveVector = parameter(
        (), 'Largest speed of each joint.', unit='rad/s'
    )
    torque_rate: PositiveVector = parameter(
        (), 'Largest rate of each torque.', unit='N m/s'
    )
    operational_speed: float = parameter(
        0.5, 'Largest speed of the operational point.', unit='m/s', gt=0.0, le=10.0
    )
    operational_turn: float = parameter(
        2.0,
        'Largest angular speed of the operational frame.',
        unit='rad/s',
        gt=0.0,
        le=50.0,
    )
    operational_acceleration: float = parameter(
        5.0,
        'Largest acceleration of a commanded motion; a tool of 0.5 kg then reads 2.5 N.',
        unit='m/s^2',
        gt=0.0,
        le=100.0,
    )
    operational_turn_acceleration: float = parameter(
        20.0,
        'Largest angular acceleration of a commanded motion.',
        unit='rad/s^2',
        gt=0.0,
        le=1000.0,
    )
    workspace_lower: Vector = parameter(
        (), 'Lower corner of the box the operational point stays in.', unit='m'
    )
    workspace_upper: Vector = parameter((), 'Upper corner of that box.', unit='m')

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        for kind in ('joint', 'workspace'):
            lower = getattr(self, f'{kind}_lower')
            upper = getattr(self, f'{kind}_upper')
            if len(lower) != len(upper) or any(a >= b for a, b in zip(lower, upper)):
                yield ConfigError(
                    f'limits.{kind}_lower',
                    f'one value below each of {kind}_upper',
                    list(lower),
                )
        if len(self.workspace_lower) not in (0, 3):
            yield ConfigError(
                'limits.workspace_lower', '3 values', len(self.workspace_lower)
            )


class CollisionConfig(Config):
    """
    Torques that neither model nor wrist sensor explains, as of a touch before the sensor.

    A generalised-momentum observer finds them in the joints. What counts as a collision grows with
    the torque that accelerates a joint.
    """

    reaction: Literal['none', 'hold', 'float', 'damp'] = parameter(
        'hold',
        'Reaction: a report only, the posture held while contact forces fade, the arm '
        'carried once it is at rest, or carried and damped.',
    )
    bandwidth: float = parameter(
        200.0,
        'K of the observer, whose time constant is 1 / K, at least 2.5 periods.',
        unit='1/s',
        gt=0.0,
        le=2000.0,
    )
    threshold: PositiveVector = parameter(
        (),
        'External torque in each joint that is a collision, at rest; empty for the shares.',
        unit='N m',
    )
    limit_share: float = parameter(
        0.03,
        "That torque over the joint's torque limit, at least 1 N m...",
        ge=0.0,
        le=1.0,
    )
    friction_share: float = parameter(
        1.0,
        '...and over its Coulomb friction (friction.coulomb), added to it.',
        ge=0.0,
        le=10.0,
    )
    dynamic_share: float = parameter(
        0.1, 'Added to it, over the torque that accelerates the joint.', ge=0.0, le=1.0
    )
    command_delay: int = parameter(
        -1,
        'Periods from a sample to the torque that answers it, for an arm that measures no '
        'torque: the command stands for it; -1 to look for no collision.',
        ge=-1,
        le=10,
    )


class WatchdogConfig(Config):
    """
    Limits of valid inputs, and how control resumes after they were exceeded.

    Ages are counted in control periods; beyond them a declared reaction takes over.
    """

    joint_max_age: float = parameter(
        1.5, 'Largest age of a joint state.', unit='periods', ge=1.0, le=1000.0
    )
    wrench_max_age: float = parameter(
        12.5,
        'Largest age of a wrench, bridged by prediction.',
        unit='periods',
        ge=1.0,
        le=1e3,
    )
    variance_max_age: float = parameter(
        4.5, 'Largest age of R, one period at best.', unit='periods', ge=2.0, le=1e4
    )
    rate_band: float = parameter(
        2.5,
        'Two periods in a row wrong by more than this factor are a fault.',
        gt=1.0,
        le=100.0,
    )
    frozen_joint_ticks: int = parameter(
        0,
        'Identical joint states in a row, while a joint moves, that mean frozen joints; 0 for '
        'encoders with steps near the motion in a period.',
        ge=0,
        le=1000,
    )
    friction_bound: float = parameter(
        0.8,
        'Largest accepted ratio of sideways to normal forces, beyond 5 N.',
        gt=0.0,
        le=10.0,
    )
    recovery_time: float = parameter(
        0.05,
        'How long all inputs must be good before control resumes, tripled by each relapse.',
        unit='s',
        ge=0.0,
        le=60.0,
    )
