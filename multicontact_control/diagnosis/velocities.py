"""What is wrong with joint velocities, as the joint positions tell it."""

from __future__ import annotations

from collections.abc import Sequence

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.supervision.velocities import OFFSET_TOLERANCE
import numpy as np

UNITS = {
    'degrees per second': 180.0 / np.pi,
    'revolutions per minute': 30.0 / np.pi,
    'revolutions per second': 0.5 / np.pi,
}  # over rad/s
FEWEST_STATES = 8  # joint states that say something
SLOWEST_SPEED = 0.01  # rad/s that say something
# Share of the largest position, by which a velocity may differ from it and still be the position.
SAME_AS_POSITION = 1e-3
# Square of the correlation, from which on two velocities differ by a factor.
CORRELATED = 0.8
ACCEPTED_FACTOR = 2.5  # by which a velocity may seem wrong
SIMILAR = 0.25  # difference from a factor or an offset, relative to it
LEAST_POWER = 1e-12  # rad^2/s^2, so that nothing is divided by 0


def explain_velocities(
    states: Matrix,
    doubt: Vector,
    names: Sequence[str],
    period: float,
) -> str:
    """
    Return what positions say against the velocities of the joint whose doubt is largest.

    Parameters
    ----------
    states
        The newest joint states, shape (k, 2 n) [rad, rad/s], oldest first.
    doubt
        How far the positions contradict each velocity, above 1 if they do, shape (n,).
    names
        Of the joints.
    period
        Between two states [s].

    Returns
    -------
    str
        Empty if nothing speaks against them.

    """
    if len(states) < FEWEST_STATES:
        return ''
    joint = int(np.argmax(doubt))
    position = states[:, joint]
    velocity = states[:, len(names) + joint]
    fault = _explain_numbers(position, velocity)
    if not fault:
        rate = np.diff(position) / period
        # Of a period, as the rate is.
        mean_velocity = 0.5 * (velocity[1:] + velocity[:-1])
        fault = _explain_rate(mean_velocity, rate, doubted=doubt[joint] > 1.0)
    if not fault:
        return ''
    return f'{names[joint]}: its velocity {fault}'


def _explain_numbers(position: Vector, velocity: Vector) -> str:
    """Return what is wrong with the numbers as such, shape (k,); empty if nothing."""
    if not np.isfinite(velocity).all():
        return 'is not a finite number'
    if np.abs(velocity).max() <= OFFSET_TOLERANCE:
        return ''
    if np.abs(velocity - position).max() <= SAME_AS_POSITION * np.abs(position).max():
        return 'is equal to its position: are the fields of the message in order?'
    if np.ptp(velocity) == 0.0:
        return f'is {velocity[-1]:.3g} rad/s whatever its position does: frozen?'
    return ''


def _explain_rate(velocity: Vector, rate: Vector, *, doubted: bool) -> str:
    """Return how a velocity differs from the rate of its position, shape (k,) [rad/s]."""
    if max(np.abs(rate).max(), np.abs(velocity).max()) < SLOWEST_SPEED:
        return ''
    power = velocity @ velocity
    rate_power = rate @ rate
    common = velocity @ rate
    if common**2 >= CORRELATED * (power * rate_power):
        size = np.sqrt(power / max(float(rate_power), LEAST_POWER))
        ratio = np.copysign(size, common)
        if not 1.0 / ACCEPTED_FACTOR < ratio < ACCEPTED_FACTOR:
            return f'is {_name_factor(float(ratio))}'
    if not doubted:
        return ''
    error = velocity - rate
    if np.std(error) < SIMILAR * abs(np.mean(error)):
        return (
            f'is {np.mean(error):.3g} rad/s beyond the rate of its position: an offset?'
        )
    return (
        f'is up to {np.abs(error).max():.3g} rad/s off the rate of its position: a delay, a '
        'low-pass, or that of another joint?'
    )


def _name_factor(ratio: float) -> str:
    """Return what a velocity is that is `ratio` times the rate of its position."""
    text = f'{abs(ratio):.3g} times the rate of its position'
    if ratio < 0.0:
        text += ', with the opposite sign'
    for name, factor in UNITS.items():
        if abs(abs(ratio) / factor - 1.0) < SIMILAR:
            return f'{text}: {name}?'
    return text
