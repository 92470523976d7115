"""Whether the figures of an arm's model are possible, and in SI units."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.errors import ConfigError
import numpy as np

SHORTEST = 0.05  # m, of a link
ODD, IMPOSSIBLE = 2.0, 5.0  # link lengths, of a centre of mass and a radius of gyration
IMBALANCE = (
    1.5  # of the largest moment to the sum of the others; published arms reach 1.16
)
WIDE, ENDLESS = (
    8.0 * math.pi,
    1440.0,
)  # rad, ranges that are rather degrees, and none at all
DENSEST = 2.3e4  # kg/m^3, osmium
OVERLOAD = 3.0  # of gravity's torque to the limit; published arms reach 1.7
# Whether it is refused, the element of the URDF, what is expected, and what is there.
Finding = tuple[bool, str, str, object]


def collect_warnings(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return what is suspicious, a line each; ConfigError with all if some is refused."""
    errors = [
        (refused, ConfigError(f'robot.urdf.{where}', expected, got))
        for refused, where, expected, got in findings
    ]
    if any(refused for refused, _ in errors):
        raise ConfigError.combine(error for _, error in errors)
    return tuple(dict.fromkeys(str(error) for _, error in errors))


def check_joint(
    name: str, axis: Vector, lower: float, upper: float
) -> Iterator[Finding]:
    """Yield what is wrong with the axis of a joint, shape (3,), and with its range [rad]."""
    if not abs(float(np.linalg.norm(axis)) - 1.0) <= 1e-3:
        yield True, f'{name}.axis', 'an axis of length 1', axis
    if not lower < upper:
        yield (
            True,
            f'{name}.limit',
            'lower < upper, or type continuous',
            f'{lower:g}, {upper:g}',
        )
    if WIDE < upper - lower <= ENDLESS:
        yield False, f'{name}.limit', 'rad', f'{lower:g} to {upper:g}: degrees?'


def check_body(
    name: str,
    length: float,
    mass: float,
    least: float,
    com: Vector,
    inertia: Matrix,
) -> Iterator[Finding]:
    """Yield what is wrong with links, of a length [m], of all, and the least one's, mass [kg]."""
    if mass <= 0.0 or least < -1e-9:
        yield True, f'{name}.mass', 'a mass > 0 kg', min(mass, least) or 'none'
        return
    if mass > DENSEST * max(length, 0.3) ** 3:
        yield (
            False,
            f'{name}.mass',
            f'one for a link of {length:.3g} m',
            f'{mass:.4g} kg: g?',
        )
    distance, moments = float(np.linalg.norm(com)), np.linalg.eigvalsh(inertia)
    length = max(length, SHORTEST)
    if distance > ODD * length:
        yield (
            distance > IMPOSSIBLE * length,
            f'{name}.origin',
            f'a centre of mass within the link of {length:.3g} m',
            f'{distance:.4g} m: mm?',
        )
    rounding = 1e-4 * mass * length**2
    if (
        moments[0] < -rounding
        or moments[2] > IMBALANCE * (moments[0] + moments[1]) + rounding
    ):
        yield (
            True,
            f'{name}.inertia',
            'principal moments > 0, none above the sum of the others',
            f'{", ".join(f"{moment:.3g}" for moment in moments)} kg m^2',
        )
    radius = math.sqrt(max(moments[2], 0.0) / max(mass, 0.01))
    if radius > ODD * length:
        unit = ('g m^2 or kg cm^2', 'kg mm^2', 'g mm^2')[
            sum(radius > share * length for share in (50.0, 2e3))
        ]
        yield (
            radius > IMPOSSIBLE * length,
            f'{name}.inertia',
            f'a radius of gyration within the link of {length:.3g} m',
            f'{radius:.3g} m, of {moments[2]:.3g} kg m^2 and {mass:.3g} kg: {unit}?',
        )


def check_torque(
    name: str,
    gravity: float,
    inertia: float,
    limit: float,
    heaviest: str,
) -> Iterator[Finding]:
    """Yield what is wrong with gravity's torque [N m], least inertia and limit of a joint."""
    if inertia <= 1e-9:
        yield True, f'{name}.inertia', 'an inertia > 0 kg m^2 about the axis', inertia
    if limit == math.inf:
        yield False, f'{name}.effort', 'a torque limit > 0 N m, or torque_limit', 'none'
    if gravity > limit:
        hint = ': masses in g, lengths in mm?' if gravity > 10.0 * limit else ''
        yield (
            gravity > OVERLOAD * limit,
            f'{name}.effort',
            f'a torque limit above the {gravity:.4g} N m of gravity, with {heaviest}',
            f'{limit:.4g} N m{hint}',
        )
