"""
The torques that take the place of the control law: after a fault, and after a deactivation.

All but `zero_torque` carry the arm once its joints were known.
`hold`: see `hold_torque`; q_0 is where it began, of holds one soon after another where the first
one began, and it goes there slowly. It is as stiff as the motion law. If that makes a joint shake,
it gets softer, and stays so: behind springs rotors swing that the model does not have, above all
with velocities that are late, being made up from positions.
`damp`: Gamma = C v + g - c diag(M) v. `float`, where the joint state is not known: gravity of the
last posture, and the last motion brought to rest open loop.

An arm that lets go of what it presses on is pushed away by it, so `hold` and `float` add
J^T N alpha of the contacts that were held. Each keeps its force while it is felt; the force of one
that is not felt any more is dropped within 20 ms; it fades while the wrench is unknown.
"""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import dot, multiply_vector
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.config.supervision import RELEASE_FORCE
from multicontact_control.dynamics.operational_space import (
    compute_mobility_and_inertia,
    InertiaSpace,
)
from multicontact_control.dynamics.terms import ModelTerms
from multicontact_control.records import (
    Contact,
    Control,
    Joint,
    MAX_COLUMNS,
    MAX_JOINTS,
    Record,
    record_dtype,
    Records,
    Task,
)
from multicontact_control.supervision.causes import (
    TO_DAMP,
    TO_FLOAT,
    TO_HOLD,
    TO_SAFE,
)
from multicontact_control.supervision.velocities import (
    OFFSET_TOLERANCE,
    SHARE_TOLERANCE,
)
import numpy as np

SAFE_BEHAVIOURS = {
    'hold_position': TO_HOLD,
    'gravity_compensation': TO_DAMP,
    'zero_torque': TO_SAFE,
}
COAST_TIME = 0.1  # s, in which an arm that cannot be seen any more is brought to rest
# 1/s, of `damp` and gravity compensation: joint damping over inertia.
DAMPING_RATE = 5.0
# Of 1 / w of a hold, which its delay is at most: 40 degrees of phase margin.
DELAY_SHARE = 0.3
ESTIMATE_DELAY = 1.5  # periods, of a velocity that is estimated from positions
FREE_FREQUENCY = 10.0  # rad/s, of what the operational point does not see of a posture
# A hold that shakes is given less damping first (a ratio), then a lower natural frequency, by this
# factor, down to so many rad/s; and so many s to calm down each time.
LESS_DAMPING = 0.5
SOFTER = 0.8
SOFTEST_HOLD = 10.0
SETTLING_TIME = 0.2
UNLIKELY_TIME = 0.1  # s, for which velocities are not used after one was unlikely
# A joint that turns round by more than SWING [rad/s] counts a turn, and forgets it within
# TURN_TIME [s]. From TURNS of them on it shakes, 13 times a second or more; an arm that is held
# by rigid drives does not swing so fast.
SWING = 0.05
TURN_TIME = 0.15
TURNS = 4.0
AHEAD = 0.2  # of v / w, by which an arm in motion is held ahead of where a hold begins
# rad/s of each joint, at which a hold goes back to where the first one began.
RETURN_SPEED = 0.05
RETURN_WAY = 0.05  # rad of a joint, beyond which it has gone somewhere else
# m, or of an axis of the reference since then, beyond which it was led elsewhere.
COMMANDED_WAY = 5e-3
FADE_TIME = 0.5  # s, by which a contact's force fades while the wrench is not known
DROP_TIME = 0.02  # s, in which the force on a surface that has gone is dropped
DROPPED = 1e-2  # N of a contact, below which that counts as done


class HeldJoint(Record, Protocol):
    """One joint of an arm that a reaction holds, and how its velocity goes up and down."""

    posture: float  # q_0, to which the joint is held [rad]
    first: float  # the same where the first of several holds began [rad]

    # Where its velocity goes, 1 or -1, the extreme on that way [rad/s], and how often it has
    # turned round, which fades.
    direction: float
    extreme: float
    turns: float

    way: float  # q_0 - q [rad]
    rate: float  # v: made up for by positions, then the one that damps the hold [rad/s]

    # a(w_0, 1), and what a(w, d) is beyond that; see `hold_torque` [rad/s^2].
    soft: float
    stiffer: float

    torque: float  # that answers instead of the law [N m]


class PressedContact(Record, Protocol):
    """The force with which one contact goes on being pressed."""

    alpha: float  # of the law's newest answer, and of the reaction since [N]


class ReactionState(Record, Protocol):
    """What the reactions are set to, and what they remember; one."""

    period: float  # h [s]
    safe_behaviour: (
        int  # TO_HOLD, TO_DAMP or TO_SAFE: what answers after a deactivation
    )
    stiffest: float  # natural frequency of a hold that does not shake [rad/s]

    # Natural frequency [rad/s] and damping ratio of the hold.
    frequency: float
    damping: float

    settling_time: float  # until the hold may be softened again [s]
    unlikely_time: float  # for which the velocities are still not used [s]
    coasting_ticks: int  # in a row that were floated
    has_posture: bool  # whether a hold is under way
    has_first: bool  # whether `first` of the joints is known
    has_reference: bool  # whether the pose is known at which the first hold began

    # That of the task's reference then [m].
    position: Annotated[Vector, 3]
    rotation: Annotated[Matrix, 3, 3]

    joints: Annotated[Records[HeldJoint], MAX_JOINTS]
    contacts: Annotated[Records[PressedContact], MAX_COLUMNS]
    presses: bool  # whether contacts go on being pressed

    inertia: InertiaSpace  # worked with
    wrench: Annotated[Vector, 6]  # worked with [N, N m]
    acceleration: Annotated[Vector, 6]  # worked with [m/s^2, rad/s^2]


REACTION_STATE = record_dtype(ReactionState)


def configure_reactions(
    state: Records[ReactionState], config: ControllerConfig
) -> None:
    """Set what follows from values that may change while the arm is controlled; one record."""
    state['period'] = config.period
    state['safe_behaviour'] = SAFE_BEHAVIOURS[config.safe_behaviour]
    delay = config.force.input_delay + ESTIMATE_DELAY * config.period
    stiffest = min(config.motion.natural_frequency, DELAY_SHARE / delay)
    if stiffest != state['stiffest'][0]:
        state['stiffest'] = stiffest
        state['frequency'] = stiffest
        state['damping'] = 1.0


@compiled
def forget_postures(state: ReactionState) -> None:
    """Let the next hold be the first one."""
    state.has_first = False
    state.has_reference = False
    end_reaction(state)


@compiled
def end_reaction(state: ReactionState) -> None:
    """Control has resumed: the next reaction begins anew, and goes back if it comes soon."""
    state.has_posture = False
    state.presses = False
    state.coasting_ticks = 0


@compiled
def remember_forces(state: ReactionState, contacts: Records[Contact]) -> None:
    """
    Remember the forces that contacts are held with, for a reaction to go on with.

    Each is the estimated force, between 0 and the desired one; a couple may have either sign.
    """
    for i in range(contacts.shape[0]):
        answer = contacts[i].answer
        most = abs(answer.alpha_des)
        least = 0.0
        if contacts[i].config.leader != i:
            least = -most
        state.contacts[i].alpha = 0.0
        if answer.active:
            state.contacts[i].alpha = min(max(answer.alpha_est, least), most)


@compiled
def return_to_first_hold(state: ReactionState, task: Task) -> None:
    """Let a hold that begins be the first one, unless the arm was not led on since that."""
    if state.has_reference:
        led = 0.0
        for i in range(3):
            led = max(led, abs(task.position[i] - state.position[i]))
            for j in range(3):
                led = max(led, abs(task.rotation[i, j] - state.rotation[i, j]))
        if led <= COMMANDED_WAY:
            return
    forget_postures(state)
    state.has_reference = True
    state.position[:] = task.position
    state.rotation[:] = task.rotation


@compiled
def presses_contact(state: ReactionState) -> bool:
    """Return whether a contact is still pressed, since the law held it."""
    if not state.presses:
        return False
    for contact in state.contacts:
        if abs(contact.alpha) > DROPPED:
            return True
    return False


@compiled
def fill_reaction_torque(
    state: ReactionState,
    reaction: int,
    joints: Records[Joint],
    control: Control,
    contacts: Records[Contact],
    terms: ModelTerms,
    wrench_known: bool,
    timed: bool,
) -> None:
    """
    Fill in `torque` of the joints in `state`: what answers instead of the law.

    Parameters
    ----------
    state
        A record of `REACTION_STATE`; `rate` of its joints has the velocities that positions make
        up for [rad/s].
    reaction
        TO_HOLD, TO_FLOAT, TO_DAMP or TO_SAFE.
    joints, control, contacts, terms
        The arm where it was seen last.
    wrench_known
        Whether the forces of the contacts are of this sample.
    timed
        Whether the clock is right. Where it is wrong, velocities that positions make up for are of
        another size, and a hold is soft.

    """
    n = joints.shape[0]
    held = state.joints[:n]
    state.coasting_ticks += 1
    if reaction != TO_FLOAT:
        state.coasting_ticks = 0
    behaviour = reaction
    if reaction == TO_SAFE:
        behaviour = state.safe_behaviour
    if behaviour == TO_DAMP:
        forget_postures(state)  # it may be moved away
        for j in range(n):
            damping = DAMPING_RATE * joints[j].inertia
            held[j].torque = joints[j].bias_torque - damping * joints[j].velocity
        return
    if behaviour == TO_SAFE:
        # Zero is what is commanded: what the drives add goes on acting.
        forget_postures(state)
        for j in range(n):
            held[j].torque = joints[j].drive_gravity_torque
        return
    if behaviour == TO_HOLD:
        hold_posture(state, held, joints, control, terms, timed)
    else:
        float_arm(state, held, joints, terms)
    if state.presses:
        press_on(state, held, contacts, terms, wrench_known)


@compiled
def float_arm(
    state: ReactionState,
    held: Records[HeldJoint],
    joints: Records[Joint],
    terms: ModelTerms,
) -> None:
    """Fill in the torque that carries the arm as it was seen last, and brings it to rest."""
    n = joints.shape[0]
    mass_matrix = terms.mass_matrix
    state.has_posture = False  # wherever it has gone meanwhile
    coasting_time = state.coasting_ticks * state.period
    if coasting_time > COAST_TIME:
        state.has_first = False
    rate = np.exp(-coasting_time / COAST_TIME) / COAST_TIME
    for i in range(n):
        held[i].torque = terms.gravity[i]
        for j in range(n):
            mass = mass_matrix[min(i, j), max(i, j)]
            held[i].torque -= rate * mass * joints[j].velocity


@compiled
def hold_posture(
    state: ReactionState,
    held: Records[HeldJoint],
    joints: Records[Joint],
    control: Control,
    terms: ModelTerms,
    timed: bool,
) -> None:
    """Fill in the torque that keeps the arm where it is, or leads it back."""
    n = joints.shape[0]
    if not state.has_posture:
        state.has_posture = True
        for j in range(n):
            held[j].posture = joints[j].q
            # It goes on by 0.37 v / w, and comes back: less so if that is allowed for.
            if timed:
                held[j].posture += AHEAD / state.frequency * held[j].rate
            held[j].direction = 1.0
            held[j].extreme = 0.0
            held[j].turns = 0.0
    farthest = 0.0
    for j in range(n):
        farthest = max(farthest, abs(held[j].first - held[j].posture))
    if not state.has_first or farthest > RETURN_WAY:
        state.has_first = True
        for j in range(n):
            held[j].first = held[j].posture
    step = RETURN_SPEED * state.period
    for j in range(n):
        back = held[j].first - held[j].posture
        held[j].posture += min(max(back, -step), step)
    soften_shaking_hold(state, held)
    state.unlikely_time -= state.period
    for j in range(n):
        # What may soon be refuted would push the arm: the estimate damps it already.
        tolerance = OFFSET_TOLERANCE + SHARE_TOLERANCE * abs(held[j].rate)
        if abs(joints[j].velocity - held[j].rate) > tolerance:
            state.unlikely_time = UNLIKELY_TIME
    for j in range(n):
        held[j].way = held[j].posture - joints[j].q
        if state.unlikely_time <= 0.0:
            held[j].rate = joints[j].velocity
    frequency = state.frequency
    if not timed:
        frequency = min(frequency, FREE_FREQUENCY)
    hold_torque(state, held, joints, control, terms, frequency)


@compiled
def soften_shaking_hold(state: ReactionState, held: Records[HeldJoint]) -> None:
    """Reduce what makes rotors shake: damping by velocities that come late."""
    keep = np.exp(-state.period / TURN_TIME)
    turns = 0.0
    for j in range(held.shape[0]):
        count_reversals(held[j], keep)
        turns = max(turns, held[j].turns)
    state.settling_time = max(state.settling_time - state.period, 0.0)
    if turns <= TURNS or state.settling_time > 0.0:
        return
    state.settling_time = SETTLING_TIME
    if state.damping > LESS_DAMPING:
        state.damping = LESS_DAMPING
        return
    softest = min(SOFTEST_HOLD, state.stiffest)
    state.frequency = max(SOFTER * state.frequency, softest)


@compiled
def count_reversals(joint: HeldJoint, keep: float) -> None:
    """Count how often the velocity of a joint turns; `keep` is what is left of the count."""
    beyond = (joint.rate - joint.extreme) * joint.direction
    joint.turns *= keep
    if beyond < -SWING:
        joint.direction = -joint.direction
        joint.turns += 1.0
    if beyond < -SWING or beyond >= 0.0:
        joint.extreme = joint.rate


@compiled
def hold_torque(
    state: ReactionState,
    held: Records[HeldJoint],
    joints: Records[Joint],
    control: Control,
    terms: ModelTerms,
    frequency: float,
) -> None:
    """
    Fill in the torque that holds a posture.

    Gamma = C v + g + J^T Lambda J a(w, d) + (M - J^T Lambda J) a(w_0, 1), where
    a(w, d) = w^2 (q_0 - q) - 2 d w v, `way` is q_0 - q and `rate` is v.
    The operational point is as stiff as under the motion law, M w^2 with six joints; what it does
    not see stays softer: with M w^2 there, the rotors behind flexible drives would swing. In a
    singular posture all of it is as soft.

    `frequency` is w [rad/s]; d is in `state`.
    """
    n = joints.shape[0]
    mass_matrix, jacobian, w = terms.mass_matrix, terms.jacobian, frequency
    free = min(w, FREE_FREQUENCY)
    for j in range(n):
        way, rate = held[j].way, held[j].rate
        stiff = w**2 * way - 2.0 * state.damping * w * rate
        held[j].soft = free**2 * way - 2.0 * free * rate
        held[j].stiffer = stiff - held[j].soft
    for i in range(n):
        held[i].torque = joints[i].bias_torque
        for j in range(n):
            held[i].torque += mass_matrix[min(i, j), max(i, j)] * held[j].soft
    damping, _ = compute_mobility_and_inertia(
        mass_matrix, jacobian, control.law.singular_mobility, state.inertia
    )
    if damping < 0.0:
        return
    for k in range(6):
        state.acceleration[k] = 0.0
        for j in range(n):
            state.acceleration[k] += jacobian[k, j] * held[j].stiffer
    multiply_vector(state.inertia.Lambda, state.acceleration, state.wrench)
    for j in range(n):
        held[j].torque += dot(jacobian[:, j], state.wrench)


@compiled
def press_on(
    state: ReactionState,
    held: Records[HeldJoint],
    contacts: Records[Contact],
    terms: ModelTerms,
    wrench_known: bool,
) -> None:
    """Add what is left of the contacts' forces at the next tick."""
    state.wrench[:] = 0.0
    for i in range(contacts.shape[0]):
        pressed = state.contacts[i]
        fading = FADE_TIME
        if wrench_known:
            leader = contacts[contacts[i].config.leader]  # a couple with its contact
            fading = np.inf
            if leader.alpha_meas <= RELEASE_FORCE:
                fading = DROP_TIME
        pressed.alpha *= np.exp(-state.period / fading)
        for k in range(6):
            state.wrench[k] += pressed.alpha * contacts[i].N[k]
    for j in range(held.shape[0]):
        held[j].torque += dot(terms.jacobian[:, j], state.wrench)
