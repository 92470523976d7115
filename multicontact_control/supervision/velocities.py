"""
Joint velocities held against joint positions, and their estimate.

Velocities are compared with positions from the first sample on: e_k = q_k - q_(k-1) - h (v_k +
v_(k-1)) / 2 of each joint is summed up with a forgetting time of 50 ms. The sum stays below 2.5e-3
rad and a quarter of the way for velocities that are less than 0.05 rad/s and 25 % wrong. The
estimate is that of a critically damped tracking filter, 1.5 periods late.

At rest any velocity that is small agrees with the positions. So a joint whose velocity they have
refuted stays in doubt until ten readings of its own motion agree, see `count_proof`.
"""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Matrix
from multicontact_control.compiled import compiled
import numpy as np

# Rows of readings, one column per joint: q, v, those of the reading before, the largest v, 2 pi
# if the angle may wrap, and the following.
Q_TRACKED, V_TRACKED, MISSED, WAY, UNREST, DOUBT = range(6, 12)  # DOUBT: contradicted above 1
UNPROVEN = 12  # readings in motion that a joint still lacks until its velocity is believed again
ROWS = 13
HISTORY = 50  # joint states that are kept for an explanation
MEMORY = 0.05  # s, in which evidence is forgotten
OFFSET = 0.05  # rad/s by which a velocity may be wrong...
SHARE = 0.25  # ...beside this share of it, which is that of a driver's low-pass, too
LARGEST_UNREST = 2.5  # rad/s that velocities go up and down beside the estimate in `MEMORY`
PROOF = 10  # joint states, from the first on or in motion after wrong ones, that prove velocities
PROVING = 0.02  # rad/s of a joint, from which on its motion may prove its velocity
# The share of that rate, and rad/s beside it, by which such a velocity may miss the estimate; one
# that misses it by twice as much begins anew.
AGREEMENT, NEAR = 0.3, 0.01
POLE = 0.5  # of the tracking filter, per period
EVEN = 1.5  # periods between two joint states, up to which they are evidence


@compiled
def check_velocities(
    joints: Matrix, history: Matrix, span: float, follows: bool, state: Any, period: float,
) -> bool:
    """
    Track positions; return whether they contradict the velocities of `joints`, rows as above.

    `span` [s] after the state before, which this one `follows` unless it is the first or jumped.
    """
    n, evident = joints.shape[1], follows and span < EVEN * period
    if not follows:
        state.states = 0
    row = history[state.states % history.shape[0]]
    state.states += 1
    keep, contradicted, silent = np.exp(-span / MEMORY), False, True
    for j in range(n):
        q, v = joints[0, j], joints[1, j]
        row[j], row[n + j] = q, v
        silent = silent and v == 0.0
        joints[DOUBT, j] = 0.0 if abs(v) <= joints[4, j] else np.inf
        if joints[DOUBT, j] > 0.0:  # no number: it says nothing, and refutes nothing
            joints[1, j] = v = joints[V_TRACKED, j]
        way = q - joints[2, j]
        if evident:
            predicted = joints[Q_TRACKED, j] + span * joints[V_TRACKED, j]
            joints[Q_TRACKED, j] = predicted + (1.0 - POLE ** 2) * (q - predicted)
            change = (1.0 - POLE) ** 2 / span * (q - predicted)
            joints[V_TRACKED, j] += change
            joints[MISSED, j] = keep * joints[MISSED, j] + way - 0.5 * span * (v + joints[3, j])
            joints[WAY, j] = keep * joints[WAY, j] + abs(way)
            joints[UNREST, j] = keep * joints[UNREST, j] + abs(v - joints[3, j] - change)
        else:
            joints[Q_TRACKED, j] = q
            if follows:
                joints[V_TRACKED, j] = way / span
            joints[MISSED, j] = joints[WAY, j] = joints[UNREST, j] = 0.0
        joints[DOUBT, j] = max(joints[DOUBT, j], joints[UNREST, j] / LARGEST_UNREST, abs(
            joints[MISSED, j]) / (OFFSET * MEMORY + SHARE * joints[WAY, j]))
        contradicted = contradicted or joints[DOUBT, j] > 1.0
    state.silent = silent and (state.silent or contradicted)
    if state.silent:
        joints[MISSED], joints[UNREST], joints[DOUBT], contradicted = 0.0, 0.0, 0.0, False
    return contradicted


@compiled
def count_proof(joints: Matrix, refuted: bool) -> bool:
    """
    Count the readings in motion that prove velocities which were `refuted`, now or before.

    Return whether a joint still lacks some. A reading counts for a joint that moves, if its
    velocity agrees with the estimate.
    """
    lacking = False
    for j in range(joints.shape[1]):
        rate, doubt = joints[V_TRACKED, j], joints[DOUBT, j]
        if refuted and 1.0 < doubt < np.inf:
            joints[UNPROVEN, j] = PROOF
        elif joints[UNPROVEN, j] > 0.0 and abs(rate) > PROVING and doubt <= 1.0:
            missing = abs(joints[1, j] - rate) / (NEAR + AGREEMENT * abs(rate))
            if missing > 2.0:
                joints[UNPROVEN, j] = PROOF
            elif missing <= 1.0:
                joints[UNPROVEN, j] -= 1.0
        lacking = lacking or joints[UNPROVEN, j] > 0.0
    return lacking
