"""
Joint velocities held against joint positions, and their estimate.

Velocities are compared with positions from the first sample on: e_k = q_k - q_(k-1) - h (v_k +
v_(k-1)) / 2 of each joint is summed up with a forgetting time of 50 ms. The sum stays below 2.5e-3
rad and a quarter of the way for velocities that are less than 0.05 rad/s and 25 % wrong. The
estimate is that of a critically damped tracking filter, 1.5 periods late.

At rest any velocity that is small agrees with the positions. So a joint whose velocity they have
refuted stays in doubt until ten readings of its own motion agree, see `count_velocity_proof`.
"""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.records import (
    Record,
    record_dtype,
    Records,
)
import numpy as np

HISTORY_STATES = 50  # joint states that are kept for an explanation
EVIDENCE_TIME = 0.05  # s, in which evidence is forgotten
OFFSET_TOLERANCE = 0.05  # rad/s by which a velocity may be wrong...
SHARE_TOLERANCE = (
    0.25  # ...beside this share of it, which is that of a driver's low-pass, too
)
LARGEST_UNREST = (
    2.5  # rad/s that velocities go up and down beside the estimate in `EVIDENCE_TIME`
)
# Joint states, from the first on or in motion after wrong ones, that prove velocities.
PROOF_STATES = 10
PROVING = 0.02  # rad/s of a joint, from which on its motion may prove its velocity
# The share of that rate, and rad/s beside it, by which such a velocity may miss the estimate; one
# that misses it by twice as much begins anew.
AGREEMENT, NEAR = 0.3, 0.01
TRACKING_POLE = 0.5  # of the tracking filter, per period
EVEN = 1.5  # periods between two joint states, up to which they are evidence


class JointTrack(Record, Protocol):
    """The positions and velocities of one joint."""

    # The newest reading: an angle that wraps goes on, and the estimate stands in for a
    # velocity that is no possible number; NaN before the first [rad], [rad/s].
    q: float
    velocity: float

    # The same of the reading before.
    last_q: float
    last_velocity: float

    # Estimated from the positions [rad], [rad/s].
    q_tracked: float
    v_tracked: float

    # Sums that fade: of what the velocities miss of the way, and of the way [rad], and
    # of how far they go up and down beside the estimate [rad/s].
    missed: float
    way: float
    unrest: float

    # Of the velocity: contradicted above 1, inf if it is not a possible number.
    contradiction: float

    # Readings in motion that its velocity lacks until it is believed again.
    velocity_probation: int

    # Rings of what came [rad], [rad/s].
    past_q: Annotated[Vector, HISTORY_STATES]
    past_velocity: Annotated[Vector, HISTORY_STATES]


JOINT_TRACK = record_dtype(JointTrack)


class VelocityState(Record, Protocol):
    """The velocities of all joints; one."""

    states: int  # joint states since the first one, or since a jump
    contradicted: int  # in a row whose velocities positions contradict
    on_probation: bool  # whether a refuted velocity has not been proven in motion since
    silent: bool  # whether none come, or only zeros
    estimated: bool  # whether positions give the velocities in use


VELOCITY_STATE = record_dtype(VelocityState)


@compiled
def check_velocities(
    tracks: Records[JointTrack],
    state: VelocityState,
    fastest: Vector,
    span: float,
    follows: bool,
    period: float,
) -> bool:
    """
    Track positions; return whether they contradict the velocities of the newest joint state.

    Parameters
    ----------
    tracks, state
        Records of `JOINT_TRACK`, shape (n,), with the newest joint state in them, and one of
        `VELOCITY_STATE`; changed.
    fastest
        Speed of each joint beyond which its velocity is no possible number, shape (n,) [rad/s].
    span, period
        Time since the joint state before, and h [s].
    follows
        Whether this one follows it; if not, it is the first, or has jumped.

    """
    evident = follows and span < EVEN * period
    if not follows:
        state.states = 0
    place = state.states % HISTORY_STATES
    state.states += 1
    keep, contradicted, silent = np.exp(-span / EVIDENCE_TIME), False, True
    for j in range(tracks.shape[0]):
        track = tracks[j]
        track.past_q[place], track.past_velocity[place] = track.q, track.velocity
        silent = silent and track.velocity == 0.0
        doubt = 0.0
        if (
            not abs(track.velocity) <= fastest[j]
        ):  # it says nothing, and refutes nothing
            doubt = np.inf
            track.velocity = track.v_tracked
        way = track.q - track.last_q
        if evident:
            predicted = track.q_tracked + span * track.v_tracked
            track.q_tracked = predicted + (1.0 - TRACKING_POLE**2) * (
                track.q - predicted
            )
            change = (1.0 - TRACKING_POLE) ** 2 / span * (track.q - predicted)
            track.v_tracked += change
            track.missed = (
                keep * track.missed
                + way
                - (0.5 * span * (track.velocity + track.last_velocity))
            )
            track.way = keep * track.way + abs(way)
            track.unrest = keep * track.unrest + (
                abs(track.velocity - track.last_velocity - change)
            )
        else:
            track.q_tracked = track.q
            if follows:
                track.v_tracked = way / span
            track.missed = track.way = track.unrest = 0.0
        track.contradiction = max(
            doubt,
            track.unrest / LARGEST_UNREST,
            abs(track.missed)
            / (OFFSET_TOLERANCE * EVIDENCE_TIME + SHARE_TOLERANCE * track.way),
        )
        contradicted = contradicted or track.contradiction > 1.0
    state.silent = silent and (state.silent or contradicted)
    if state.silent:
        contradicted = False
        for j in range(tracks.shape[0]):
            track = tracks[j]
            track.missed = track.unrest = track.contradiction = 0.0
    return contradicted


@compiled
def count_velocity_proof(tracks: Records[JointTrack], refuted: bool) -> bool:
    """
    Count the readings in motion that prove velocities which were `refuted`, now or before.

    Return whether a joint still lacks some. A reading counts for a joint that moves, if its
    velocity agrees with the estimate. `tracks`, records of `JOINT_TRACK`, are changed.
    """
    lacking = False
    for j in range(tracks.shape[0]):
        track = tracks[j]
        rate = track.v_tracked
        if refuted and 1.0 < track.contradiction < np.inf:
            track.velocity_probation = PROOF_STATES
        elif (
            track.velocity_probation > 0
            and abs(rate) > PROVING
            and track.contradiction <= 1.0
        ):
            missing = abs(track.velocity - rate) / (NEAR + AGREEMENT * abs(rate))
            if missing > 2.0:
                track.velocity_probation = PROOF_STATES
            elif missing <= 1.0:
                track.velocity_probation -= 1
        lacking = lacking or track.velocity_probation > 0
    return lacking
