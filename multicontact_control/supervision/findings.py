"""What readings say of the cause of a fault, and what to check: a sentence for each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from multicontact_control.arrays import Matrix
from multicontact_control.control import arm
from multicontact_control.control.arm import DIRECTION, WRENCH
from multicontact_control.supervision.velocities import OFFSET
import numpy as np

UNITS = {180.0 / np.pi: 'degrees per second', 30.0 / np.pi: 'revolutions per minute',
         0.5 / np.pi: 'revolutions per second'}
CORRELATED = 0.8  # square of the correlation from which on two velocities differ by a factor
FEWEST, SLOWEST = 8, 0.01  # joint states, and rad/s, that say something
SIMILAR = 0.25  # difference from a factor, relative to it
RIGHT = 2.5  # factor by which a velocity may seem wrong
EXPLAINED = 0.7  # share of the residual's power, from which on what it follows is its cause
MULTIPLE = 0.95  # the same over the joints at rest, from which on it is a multiple of gravity
# What to say of a residual that follows each of `REGRESSORS`.
FOLLOWED = (
    'follows the sign of the speed: {} N m of friction that friction.coulomb does not declare',
    'is {} N m s/rad times the speed: check friction.viscous and the scale of the velocities',
    'is {} kg m^2 times the acceleration: check robot.armature and the scale of the effort',
    'follows the wrench, of which the torques show {} times: check its sign, unit and frame '
    '(robot.sensor_frame), and the scale of the effort')


def explain_velocities(
    states: Matrix, doubt: Any, names: Sequence[str], period: float,
) -> str:
    """
    Return what positions say against the velocities of the joint whose `doubt` is largest.

    Of the newest joint states, shape (k, 2 n) [rad, rad/s], oldest first; empty if that is
    nothing, or if there are too few. `doubt` is the row `DOUBT` of `velocities`, h in [s].
    """
    if len(states) < FEWEST:
        return ''
    j = int(np.argmax(doubt))
    q, v, what = states[:, j], states[:, len(names) + j], f'{names[j]}: its velocity'
    if not np.isfinite(v).all():
        return f'{what} is not a finite number'
    if np.abs(v).max() > OFFSET:
        if np.abs(v - q).max() <= 1e-3 * np.abs(q).max():
            return f'{what} is equal to its position: are the fields of the message in order?'
        if np.ptp(v) == 0.0:
            return f'{what} is {v[-1]:.3g} rad/s whatever its position does: frozen?'
    rate, reading = np.diff(q) / period, 0.5 * (v[1:] + v[:-1])
    if max(np.abs(rate).max(), np.abs(reading).max()) < SLOWEST:
        return ''
    power, common = (reading @ reading) * (rate @ rate), reading @ rate
    if common ** 2 >= CORRELATED * power:
        ratio = np.copysign(np.sqrt(reading @ reading / max(float(rate @ rate), 1e-12)), common)
        unit = next((f': {name}?' for factor, name in UNITS.items()
                     if abs(abs(ratio) / factor - 1.0) < SIMILAR), '')
        sign = ', with the opposite sign' if ratio < 0.0 else ''
        if not 1.0 / RIGHT < ratio < RIGHT:
            return f'{what} is {abs(ratio):.3g} times the rate of its position{sign}{unit}'
    if doubt[j] <= 1.0:
        return ''
    error = reading - rate
    if np.std(error) < SIMILAR * abs(np.mean(error)):
        return f'{what} is {np.mean(error):.3g} rad/s beyond the rate of its position: an offset?'
    return (f'{what} is up to {np.abs(error).max():.3g} rad/s off the rate of its position: a '
            'delay, a low-pass, or that of another joint?')


@np.errstate(all='ignore')  # of impossible efforts
def explain_collision(joints: Any, momentum: Any, names: Sequence[str]) -> str:
    """Return what speaks for which cause of a collision, from the records of the observer."""
    residual = joints['residual']
    shares = np.abs(residual) / (joints['threshold'] + joints['slack'])
    worst = int(np.argmax(shares))
    name, evidence = names[worst], joints['evidence'][worst]
    loaded = [joint for joint, share in zip(names, shares) if share > arm.RELEASE] or [name]
    if evidence['rested'] < 0.5 * arm.REST_TIME or evidence['at_rest'] / residual[worst] > 0.5:
        settled = 1.0 - np.exp(-momentum['bandwidth'] * evidence['rested'])
        return (f'{name}: the residual is there from the first sample on'
                + _explain_rest(residual / settled, joints['bias_torque'], len(loaded)))
    squares = np.maximum(evidence['square'], np.finfo(float).tiny)
    share, slope = evidence['product'] ** 2 / squares, evidence['product'] / squares
    share[:WRENCH][slope[:WRENCH] < 0.0] = 0.0  # what pushes a joint moves it that way, too
    best = int(np.argmax(share))
    if share[best] > EXPLAINED * evidence['power']:
        factor = f'{slope[best] + (best == WRENCH):.2g}' if best != DIRECTION else (
            f'at least {max(abs(residual[worst]), evidence["friction"]):.2g}')
        return f'{name}: the residual {FOLLOWED[best].format(factor)}'
    return (f'the residual grew in {", ".join(loaded)}: something touches the arm at or before '
            f'the link that {loaded[-1]} moves; if not, check robot.armature and the effort of '
            f'{name}, the frame of the wrench, and that no other node commands the arm')


def _explain_rest(residual: Any, gravity: Any, loaded: int) -> str:
    product, square = residual @ gravity, gravity @ gravity
    factor = product / square
    if product ** 2 > MULTIPLE * square * (residual @ residual) and (
            abs(factor + 1.0) < 0.2 or abs(factor) > 1.5):
        return (f', {factor:.2g} times the torque of gravity: check unit and sign of the effort, '
                'and whether it lacks gravity (robot.adds_gravity)')
    if loaded == 1:
        return ', in this joint alone: check scale, sign and offset of its effort'
    return (': check the masses of tool and links, sign and offset of the wrench, the offsets of '
            'the effort, and that no other node commands the arm')


def undeclared_friction(joints: Any, names: Sequence[str]) -> Iterator[str]:
    """Yield a sentence for each joint that has shown friction which is not declared."""
    for joint, name in zip(joints, names):
        friction = joint['evidence']['friction']
        if joint['evidence']['moved'] > 0.5 * arm.LEARNING_TIME and (
                friction > arm.RELEASE * joint['least_threshold']):
            yield f'{name}: the residual {FOLLOWED[DIRECTION].format(f"{friction:.2g}")}'
