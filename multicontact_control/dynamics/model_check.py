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
    """
    A figure of a URDF that is impossible, or suspicious.

    Attributes
    ----------
    impossible
        Whether the arm is refused for it; otherwise it is a warning.
    element
        Element of the URDF: the name of joint or links, a dot, and what the figure is.
    expected, got
        What the figure should be, and what it is.

    """

    impossible: bool
    element: str
    expected: str
    got: object


@dataclass(frozen=True)
class Body:
    """
    The links that one joint carries, joined.

    Attributes
    ----------
    name
        Names of the links, joined by plus signs.
    length
        Distance from the joint to the next, or to the farthest frame of the links [m].
    mass, least_mass
        Mass of all links together, and of the lightest single one [kg].
    com
        Centre of mass, from the joint in its frame, shape (3,) [m].
    inertia
        Inertia about the centre of mass, shape (3, 3) [kg m^2].

    """

    name: str
    length: float
    mass: float
    least_mass: float
    com: Vector
    inertia: Matrix


@dataclass(frozen=True)
class JointLoad:
    """
    What a joint has to carry, and what its motor can.

    Attributes
    ----------
    name
        Name of the joint.
    gravity
        Largest torque of gravity in many postures [N m].
    inertia
        Least inertia about the axis in many postures [kg m^2].
    limit
        Largest torque of the motor, infinite if none is known [N m].

    """

    name: str
    gravity: float
    inertia: float
    limit: float


def collect_warnings(findings: Iterable[Finding]) -> tuple[str, ...]:
    """
    Return the suspicious findings as warnings, a line each; equal lines appear once.

    Raises
    ------
    ConfigError
        With all findings, the suspicious ones too, if one of them is impossible.

    """
    errors = []
    is_refused = False
    for finding in findings:
        field = f'robot.urdf.{finding.element}'
        errors.append(ConfigError(field, finding.expected, finding.got))
        if finding.impossible:
            is_refused = True
    if is_refused:
        raise ConfigError.combine(errors)
    return tuple(dict.fromkeys(map(str, errors)))


def check_joint(
    name: str, axis: Vector, lower: float, upper: float
) -> Iterator[Finding]:
    """
    Yield defects of a joint's axis and range.

    Parameters
    ----------
    name
        Name of the joint.
    axis
        Axis of the joint, shape (3,), of length 1 as it should be; NaN is a defect too.
    lower, upper
        Ends of the range [rad]; a range far wider than turns are is taken for one without ends,
        one of some hundreds for degrees.

    """
    length = float(np.linalg.norm(axis))
    if not abs(length - 1.0) <= 1e-3:
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
    """
    Yield defects of a body's mass, centre of mass and inertia.

    Without a mass above 0 the other figures say nothing, and are not looked at. A body counts as
    heavy if it outweighs a cube of osmium of its length.
    """
    if body.mass <= 0.0 or body.least_mass < -1e-9:
        least: object = min(body.mass, body.least_mass)
        if least == 0.0:
            least = 'none'
        yield Finding(True, f'{body.name}.mass', 'a mass > 0 kg', least)
        return
    heaviest = DENSEST * max(body.length, 0.3) ** 3
    if body.mass > heaviest:
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
    largest_balanced = LARGEST_IMBALANCE * (smallest + middle) + rounding
    if smallest < -rounding or largest > largest_balanced:
        texts = [f'{moment:.3g}' for moment in moments]
        yield Finding(
            True,
            f'{body.name}.inertia',
            'principal moments > 0, none above the sum of the others',
            f'{", ".join(texts)} kg m^2',
        )
    mass = max(body.mass, 0.01)
    radius = math.sqrt(max(largest, 0.0) / mass)
    if radius > SUSPICIOUS_REACH * length:
        unit = _guess_inertia_unit(radius / length)
        yield Finding(
            radius > IMPOSSIBLE_REACH * length,
            f'{body.name}.inertia',
            f'a radius of gyration within the link of {length:.3g} m',
            f'{radius:.3g} m, of {largest:.3g} kg m^2 and {body.mass:.3g} kg: {unit}?',
        )


def _guess_inertia_unit(lengths: float) -> str:
    """Return the unit that a radius of gyration of so many link lengths is likely to come from."""
    likely_units = [unit for least, unit in INERTIA_UNITS if lengths > least]
    return likely_units[0]


def check_load(load: JointLoad, heaviest: str) -> Iterator[Finding]:
    """
    Yield defects of a joint's inertia and torque limit.

    Parameters
    ----------
    load
        What the joint has to carry.
    heaviest
        Mass and name of the heaviest body of the arm, which may explain too much gravity.

    """
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
        hint = ''
        if load.gravity > 10.0 * load.limit:
            hint = ': masses in g, lengths in mm?'
        yield Finding(
            load.gravity > OVERLOAD * load.limit,
            f'{name}.effort',
            f'a torque limit above the {load.gravity:.4g} N m of gravity, with {heaviest}',
            f'{load.limit:.4g} N m{hint}',
        )
