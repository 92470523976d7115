"""
Joint velocities held against joint positions, and their estimate where they cannot be used.

Velocities are compared with positions from the first sample on: e_k = q_k - q_(k-1) - h (v_k +
v_(k-1)) / 2 of each joint is summed up with a forgetting time of 50 ms. The sum stays below 2.5e-3
rad and a quarter of the way for velocities that are less than 0.05 rad/s and 25 % wrong. The
estimate is that of a critically damped tracking filter, 1.5 periods late.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from multicontact_control.arrays import Matrix
from multicontact_control.compiled import compiled
import numpy as np

# Rows of readings, one column per joint: q, v, those of the reading before, the largest v, 2 pi
# if the angle may wrap, and the following.
Q_TRACKED, V_TRACKED, MISSED, WAY, UNREST = range(6, 11)
ROWS = 11
HISTORY = 50  # joint states that are kept for an explanation

MEMORY = 0.05  # s, in which evidence is forgotten
OFFSET = 0.05  # rad/s by which a velocity may be wrong...
SHARE = 0.25  # ...beside this share of it, which is that of a driver's low-pass, too
LARGEST_UNREST = 5.0  # rad/s that velocities go up and down within `MEMORY`
PROOF = 10  # joint states of an arm that moves, before velocities are believed (again)
POLE = 0.5  # of the tracking filter, per period
UNITS = {180.0 / np.pi: 'degrees per second', 30.0 / np.pi: 'revolutions per minute',
         0.5 / np.pi: 'revolutions per second'}
CORRELATED = 0.8  # square of the correlation from which on two velocities differ by a factor
FEWEST, SLOWEST = 8, 0.01  # joint states, and rad/s, that say something
STILL = 1e-4  # rad/s, below which a joint stands
SIMILAR = 0.25  # difference from a factor, relative to it
EVEN = 1.5  # periods between two joint states, up to which they are evidence


@compiled
def check_velocities(
    joints: Matrix, history: Matrix, span: float, follows: bool, state: Any, period: float,
) -> bool:
    """
    Track positions, and return whether they contradict the velocities of a joint state.

    `joints` are rows as above; `span` is the time since the state before [s], which this one
    `follows` unless it is the first or has jumped. `state.silent` says whether joints move without
    velocities, `agreeing` counts states of joints that move.
    """
    n, evident = joints.shape[1], follows and span < EVEN * period
    if not follows:
        state.states = 0
    row = history[state.states % history.shape[0]]
    state.states += 1
    keep, contradicted, silent, fastest = np.exp(-span / MEMORY), False, True, 0.0
    for j in range(n):
        q, v = joints[0, j], joints[1, j]
        row[j], row[n + j] = q, v
        silent = silent and v == 0.0
        if not abs(v) <= joints[4, j]:
            contradicted = True
            joints[1, j] = v = 0.0
        way = q - joints[2, j]
        if evident:
            predicted = joints[Q_TRACKED, j] + span * joints[V_TRACKED, j]
            joints[Q_TRACKED, j] = predicted + (1.0 - POLE ** 2) * (q - predicted)
            joints[V_TRACKED, j] += (1.0 - POLE) ** 2 / span * (q - predicted)
            joints[MISSED, j] = keep * joints[MISSED, j] + way - 0.5 * span * (v + joints[3, j])
            joints[WAY, j] = keep * joints[WAY, j] + abs(way)
            joints[UNREST, j] = keep * joints[UNREST, j] + abs(v - joints[3, j])
        else:
            joints[Q_TRACKED, j] = q
            if follows:
                joints[V_TRACKED, j] = way / span
            joints[MISSED, j] = joints[WAY, j] = joints[UNREST, j] = 0.0
        fastest = max(fastest, abs(joints[V_TRACKED, j]))
    state.silent = silent and fastest > STILL
    if fastest > OFFSET:
        state.agreeing += 1
    for j in range(n):
        if state.silent:
            joints[MISSED, j] = joints[UNREST, j] = 0.0
        contradicted = contradicted or joints[UNREST, j] > LARGEST_UNREST or (
            abs(joints[MISSED, j]) > OFFSET * MEMORY + SHARE * joints[WAY, j])
    return bool(contradicted)


def explain_velocities(
    history: Matrix, states: int, joints: Matrix, names: Sequence[str], period: float,
) -> str:
    """
    Return which joint's velocities positions speak against most, and what may be why.

    Parameters
    ----------
    history, states, joints
        The newest joint states as they came, a ring of shape (k, 2 n) [rad, rad/s], how many of
        them there were, and rows as above, shape (11, n).
    names, period
        Of the joints; h [s].

    Returns
    -------
    str
        Empty if nothing speaks against them, or if there are too few joint states.

    """
    n, count = len(names), min(states, len(history))
    if count < FEWEST:
        return ''
    rows = np.roll(history, -states, axis=0)[-count:]
    impossible = ~(np.abs(rows[-1, n:]) <= joints[4])
    j = int(np.argmax(impossible if impossible.any() else np.maximum(
        np.abs(joints[MISSED]) / (OFFSET * MEMORY + SHARE * joints[WAY]),
        joints[UNREST] / LARGEST_UNREST)))
    q, v, what = rows[:, j], rows[:, n + j], f'{names[j]}: its velocity'
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
    power, common = float(reading @ reading), float(reading @ rate)
    ratio = np.copysign(np.sqrt(power / max(float(rate @ rate), 1e-12)), common)
    error = reading - rate
    if common ** 2 >= CORRELATED * power * float(rate @ rate):
        unit = next((f': {name}?' for factor, name in UNITS.items()
                     if abs(abs(ratio) / factor - 1.0) < SIMILAR), '')
        sign = ', with the opposite sign' if ratio < 0.0 else ''
        return '' if abs(ratio - 1.0) < SIMILAR else (
            f'{what} is {abs(ratio):.3g} times the rate of its position{sign}{unit}')
    if abs(joints[MISSED, j]) < OFFSET * MEMORY and not joints[UNREST, j] > LARGEST_UNREST:
        return ''
    if np.std(error) < SIMILAR * abs(np.mean(error)):
        return f'{what} is {np.mean(error):.3g} rad/s beyond the rate of its position: an offset?'
    return (f'{what} is up to {np.abs(error).max():.3g} rad/s off the rate of its position: a '
            'delay, a low-pass, or that of another joint?')
