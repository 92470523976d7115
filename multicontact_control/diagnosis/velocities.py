"""
Tell an operator how joint velocities contradict joint positions.

Velocities that a driver gives in degrees, of another joint or late are named as such.
"""

from __future__ import annotations

from collections.abc import Sequence

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.supervision.velocities import OFFSET_TOLERANCE
import numpy as np

# Units that a driver may give velocities in: the number that stands for 1 rad/s.
UNITS = {
    'degrees per second': 180.0 / np.pi,
    'revolutions per minute': 30.0 / np.pi,
    'revolutions per second': 0.5 / np.pi,
}
FEWEST_STATES = 8  # joint states that say something
SLOWEST_SPEED = 0.01  # rad/s that say something
# Share of the largest position, by which a velocity may differ from it and still be the position.
SAME_AS_POSITION = 1e-3
# cos^2 of the angle between velocities and rates, as vectors of all samples with their means, from
# which on they differ by a factor only.
CORRELATED = 0.8
ACCEPTED_FACTOR = 2.5  # by which a velocity may seem wrong
UNIT_TOLERANCE = 0.25  # of a factor to that of a unit, relative to it
OFFSET_SPREAD = 0.25  # standard deviation over mean, up to which an error is an offset
LEAST_POWER = 1e-12  # rad^2/s^2, sum of squares of a position that rests


def explain_velocities(
    states: Matrix,
    doubt: Vector,
    names: Sequence[str],
    period: float,
) -> str:
    """
    Return what is wrong with the velocity that positions contradict most, for the operator.

    After a collision any text also puts that velocity on probation, see
    `Explanations.comes_of_velocities`.

    Parameters
    ----------
    states
        The newest joint states, shape (k, 2 n) [rad, rad/s], oldest first.
    doubt
        How far the positions contradict each velocity, above 1 if they do, shape (n,).
    names
        Names of the joints, n of them.
    period
        Sampling period h; states without gaps are assumed [s].

    Returns
    -------
    str
        Empty if nothing speaks against it.

    """
    if len(states) < FEWEST_STATES:
        return ''
    joint = int(np.argmax(doubt))
    position = states[:, joint]
    velocity = states[:, len(names) + joint]
    fault = _explain_numbers(position, velocity)
    if not fault:
        rate = np.diff(position) / period
        # Mean over the same interval as the difference quotient.
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
        return ''  # near 0 a joint that rests has a position equal to its velocity, rightly
    if np.abs(velocity - position).max() <= SAME_AS_POSITION * np.abs(position).max():
        return 'is equal to its position: are the fields of the message in order?'
    return ''


def _explain_rate(velocity: Vector, rate: Vector, *, doubted: bool) -> str:
    """
    Return how a velocity differs from the rate of its position, shape (k - 1,) [rad/s].

    A factor is told of any velocity, other differences of one that positions contradict
    (`doubted`): a velocity that is right may stay the same, and is a little late.
    """
    if max(np.abs(rate).max(), np.abs(velocity).max()) < SLOWEST_SPEED:
        return ''
    power = velocity @ velocity
    rate_power = rate @ rate
    common = velocity @ rate
    moves = rate_power > LEAST_POWER
    if moves and common**2 >= CORRELATED * (power * rate_power):
        size = np.sqrt(power / rate_power)
        ratio = np.copysign(size, common)
        if not 1.0 / ACCEPTED_FACTOR < ratio < ACCEPTED_FACTOR:
            return _describe_factor(float(ratio))
    if not doubted:
        return ''
    error = velocity - rate
    if np.std(error) < OFFSET_SPREAD * abs(np.mean(error)):
        return (
            f'is {np.mean(error):.3g} rad/s beyond the rate of its position: an offset?'
        )
    if np.ptp(velocity) == 0.0:
        return f'is {velocity[-1]:.3g} rad/s whatever its position does: frozen?'
    return (
        f'is up to {np.abs(error).max():.3g} rad/s off the rate of its position: delayed, '
        'low-passed, or the velocity of another joint?'
    )


def _describe_factor(ratio: float) -> str:
    """Return that a velocity is `ratio` times the rate of its position, and of which unit."""
    text = f'is {abs(ratio):.3g} times the rate of its position'
    if ratio < 0.0:
        text += ', with the opposite sign'
    for name, factor in UNITS.items():
        if abs(abs(ratio) / factor - 1.0) < UNIT_TOLERANCE:
            return f'{text}: {name}?'
    return text
