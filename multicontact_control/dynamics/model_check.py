"""
Whether the figures of an arm's model are possible, and in SI units.

A vendor's URDF may hold masses in g, lengths in mm or inertias in kg mm^2. Each check yields what
it finds; `collect_warnings` refuses what is impossible and returns what is suspicious.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
import math
from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.errors import ConfigError
import numpy as np

SHORTEST_LINK = 0.05  # m
# Link lengths, of a centre of mass and a radius of gyration.
SUSPICIOUS_REACH = 2.0
IMPOSSIBLE_REACH = 5.0
# Of the largest principal moment to the sum of the others; published arms reach 1.16.
LARGEST_IMBALANCE = 1.5
# rad: a range above the first is one in degrees, above the second it stands for none.
WIDEST_RANGE = 8.0 * math.pi
ENDLESS_RANGE = 1440.0
DENSEST = 2.3e4  # kg/m^3, osmium
OVERLOAD = 3.0  # of gravity's torque to the limit; published arms reach 1.7
# Link lengths of a radius of gyration from which on a unit is the likelier one.
INERTIA_UNITS = ((2e3, 'g mm^2'), (50.0, 'kg mm^2'), (0.0, 'g m^2 or kg cm^2'))


class Finding(NamedTuple):
    """A figure of a URDF that is impossible, or suspicious."""

    refused: bool  # whether it is impossible
    element: str  # of the URDF
    expected: str
    got: object


@dataclass(frozen=True)
class Body:
    """The links that one joint carries, joined."""

    name: str
    length: float  # [m]
    mass: float  # of all links together [kg]
    least_mass: float  # of a single link [kg]
    com: Vector  # centre of mass, from the joint, shape (3,) [m]
    inertia: Matrix  # about the centre of mass, shape (3, 3) [kg m^2]


@dataclass(frozen=True)
class JointLoad:
    """What a joint has to carry, and what its motor can."""

    name: str
    gravity: float  # largest torque of gravity in many postures [N m]
    inertia: float  # least inertia about the axis in many postures [kg m^2]
    limit: float  # of the torque; infinite if there is none [N m]


def collect_warnings(findings: Iterable[Finding]) -> tuple[str, ...]:
    """
    Return the suspicious findings, a line each.

    Raises
    ------
    ConfigError
        With all findings, if one of them is refused.

    """
    errors = []
    refused = False
    for finding in findings:
        field = f'robot.urdf.{finding.element}'
        errors.append(ConfigError(field, finding.expected, finding.got))
        refused = refused or finding.refused
    if refused:
        raise ConfigError.combine(errors)
    return tuple(dict.fromkeys(map(str, errors)))


def check_joint(
    name: str, axis: Vector, lower: float, upper: float
) -> Iterator[Finding]:
    """Yield defects of a joint's axis, shape (3,), and of its range [rad]."""
    if not abs(float(np.linalg.norm(axis)) - 1.0) <= 1e-3:
        yield Finding(True, f'{name}.axis', 'an axis of length 1', axis)
    if not lower < upper:
        yield Finding(
            True,
            f'{name}.limit',
            'lower < upper, or type continuous',
            f'{lower:g}, {upper:g}',
        )
    if WIDEST_RANGE < upper - lower <= ENDLESS_RANGE:
        yield Finding(
            False, f'{name}.limit', 'rad', f'{lower:g} to {upper:g}: degrees?'
        )


def check_body(body: Body) -> Iterator[Finding]:
    """Yield defects of a body's mass, centre of mass and inertia."""
    if body.mass <= 0.0 or body.least_mass < -1e-9:
        least = min(body.mass, body.least_mass)
        yield Finding(True, f'{body.name}.mass', 'a mass > 0 kg', least or 'none')
        return
    if body.mass > DENSEST * max(body.length, 0.3) ** 3:
        yield Finding(
            False,
            f'{body.name}.mass',
            f'one for a link of {body.length:.3g} m',
            f'{body.mass:.4g} kg: g?',
        )
    length = max(body.length, SHORTEST_LINK)
    distance = float(np.linalg.norm(body.com))
    if distance > SUSPICIOUS_REACH * length:
        yield Finding(
            distance > IMPOSSIBLE_REACH * length,
            f'{body.name}.origin',
            f'a centre of mass within the link of {length:.3g} m',
            f'{distance:.4g} m: mm?',
        )
    yield from _check_inertia(body, length)


def _check_inertia(body: Body, length: float) -> Iterator[Finding]:
    """Yield defects of a body's inertia; the length is that of its links, at least [m]."""
    moments = np.linalg.eigvalsh(body.inertia)
    smallest, middle, largest = moments
    rounding = 1e-4 * body.mass * length**2
    unbalanced = largest > LARGEST_IMBALANCE * (smallest + middle) + rounding
    if smallest < -rounding or unbalanced:
        texts = [f'{moment:.3g}' for moment in moments]
        yield Finding(
            True,
            f'{body.name}.inertia',
            'principal moments > 0, none above the sum of the others',
            f'{", ".join(texts)} kg m^2',
        )
    radius = math.sqrt(max(largest, 0.0) / max(body.mass, 0.01))
    if radius > SUSPICIOUS_REACH * length:
        likely_units = [
            unit for lengths, unit in INERTIA_UNITS if radius > lengths * length
        ]
        yield Finding(
            radius > IMPOSSIBLE_REACH * length,
            f'{body.name}.inertia',
            f'a radius of gyration within the link of {length:.3g} m',
            f'{radius:.3g} m, of {largest:.3g} kg m^2 and {body.mass:.3g} kg: {likely_units[0]}?',
        )


def check_load(load: JointLoad, heaviest: str) -> Iterator[Finding]:
    """Yield defects of a joint's inertia and torque limit; `heaviest` names the heaviest body."""
    name = load.name
    if load.inertia <= 1e-9:
        yield Finding(
            True,
            f'{name}.inertia',
            'an inertia > 0 kg m^2 about the axis',
            load.inertia,
        )
    if load.limit == math.inf:
        yield Finding(
            False, f'{name}.effort', 'a torque limit > 0 N m, or torque_limit', 'none'
        )
    if load.gravity > load.limit:
        far_beyond = load.gravity > 10.0 * load.limit
        hint = ': masses in g, lengths in mm?' if far_beyond else ''
        yield Finding(
            load.gravity > OVERLOAD * load.limit,
            f'{name}.effort',
            f'a torque limit above the {load.gravity:.4g} N m of gravity, with {heaviest}',
            f'{load.limit:.4g} N m{hint}',
        )
