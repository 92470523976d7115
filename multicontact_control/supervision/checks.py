"""What an answer of the control law is checked for, and which residual is a collision."""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import add_scaled_vector, vector_length
from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.wrench import operational_wrench
from multicontact_control.control.controller import Controller
from multicontact_control.flags import (
    ANSWER_NOT_FINITE,
    ANSWER_REFUSED,
    FORCE_SIDEWAYS,
    FORCE_STRAY,
    OUTSIDE_WORKSPACE,
    SURFACE_PULLS,
)
from multicontact_control.records import (
    Contact,
    Control,
    Joint,
    Record,
    record_dtype,
    Records,
)
from multicontact_control.supervision.contacts import ContactState, FREE, LOST
import numpy as np

CONTRADICTING = SURFACE_PULLS | FORCE_STRAY | FORCE_SIDEWAYS
# Samples in a row that contradict the contacts, for the wrench to be refused.
CONTRADICTIONS = 2
PULL_LIMIT = 4.0  # N, measured pull of a surface that is accepted
# N, the same of all that is read, with what is taken off as no force.
READ_PULL_LIMIT = 8.0
LOSS_ACCELERATION = 20.0  # m/s^2, of a tool that is braked after a contact is lost
SIDEWAYS_LIMIT = 5.0  # N of sideways force that is always accepted
# Times a speed limit, beyond which gate and reference have failed.
SPEED_ALARM_FACTOR = 1.1
BOX_EXCESS = 0.01  # m beyond the workspace, where the reference has failed
LEAST_THRESHOLD = 1.0  # N m, of a residual that is a collision
LEARNT_SHARE = 0.1  # of a torque limit, that learnt friction adds to it at most


class Plausibility(Record, Protocol):
    """What a plausible answer of the law keeps to; one."""

    inertia: float  # what a lost contact may read more: the tool's inertia [N]
    friction_bound: float  # force across the normals, per force along them
    force_ceiling: float  # along them, of contacts that are not commanded [N]

    # Corners of the box of the operational point [m].
    lower: Annotated[Vector, 3]
    upper: Annotated[Vector, 3]


PLAUSIBILITY = record_dtype(Plausibility)


class Judgement(Record, Protocol):
    """
    How answers have been judged; one.

    A single sample whose wrench contradicts the contacts is bridged, a second one is refused.
    """

    plausibility: Plausibility

    # Whether the law resumes, so that one contradicting sample is enough to refuse it.
    resumes: bool

    contradictions: int  # samples in a row whose wrench contradicts the contacts

    # At the operational point, without the contacts' normal forces [N, N m].
    wrench: Annotated[Vector, 6]


JUDGEMENT = record_dtype(Judgement)


@compiled
def check_plausibility(
    bounds: Plausibility,
    control: Control,
    joints: Records[Joint],
    contacts: Records[Contact],
    states: Records[ContactState],
    wrench: Vector,
) -> int:
    """
    Check the answer of the control law that is in the joints.

    Parameters
    ----------
    bounds
        A record of `PLAUSIBILITY`.
    control, joints, contacts, states
        A record of `CONTROL`, and records of `JOINT`, shape (n,), of `CONTACT` and of
        `CONTACT_STATE`, shape (r,).
    wrench
        Shape (6,), overwritten: the force that the contacts leave unexplained [N], and the torque
        at the operational point [N m].

    Returns
    -------
    int
        The sum of ANSWER_NOT_FINITE; SURFACE_PULLS, beyond what was read before (a lost contact is
        allowed the inertia of the tool that is braked); FORCE_SIDEWAYS, more than friction can
        explain; FORCE_STRAY, a free contact beyond the force ceiling; and OUTSIDE_WORKSPACE, of
        the operational point.

    """
    found = 0
    for j in range(joints.shape[0]):
        if not np.isfinite(joints[j].answer.torque):
            found = ANSWER_NOT_FINITE
    operational_wrench(control, wrench)
    sideways = wrench[:3]
    pressed = 0.0
    for i in range(contacts.shape[0]):
        contact, state = contacts[i], states[i]
        answer = contact.answer
        sum_of_answer = (
            contact.alpha_meas
            + answer.alpha_des
            + answer.alpha_est
            + answer.alpha_rate_est
            + answer.innovation
            + answer.prior_variance
            + answer.variance_used
        )
        if not np.isfinite(sum_of_answer):
            found |= ANSWER_NOT_FINITE
        if contact.config.leader != i:  # a couple has no normal force
            continue
        reading = contact.alpha_meas + contact.untared
        pressed += abs(contact.alpha_meas)
        add_scaled_vector(sideways, -reading, contact.normal)
        allowance = 0.0
        if state.state == LOST:
            allowance = bounds.inertia
        free_pull = 0.0
        if state.state == FREE:  # its search begins with what it is read with
            free_pull = min(state.baseline, 0.0)
            if contact.alpha_meas > bounds.force_ceiling:
                found |= FORCE_STRAY
        if contact.alpha_meas - free_pull < -(PULL_LIMIT + allowance):
            found |= SURFACE_PULLS
        if reading < -(READ_PULL_LIMIT + allowance):
            found |= SURFACE_PULLS
    if vector_length(sideways) > SIDEWAYS_LIMIT + bounds.friction_bound * pressed:
        found |= FORCE_SIDEWAYS
    position = control.frame.position
    for k in range(3):
        if position[k] < bounds.lower[k] or position[k] > bounds.upper[k]:
            found |= OUTSIDE_WORKSPACE
    return found


@compiled
def judge_answer(
    judgement: Judgement,
    control: Control,
    joints: Records[Joint],
    contacts: Records[Contact],
    states: Records[ContactState],
    strict: bool,
) -> int:
    """
    Judge the answer of the control law that is in the joints; see `check_plausibility`.

    Returns what that finds, and ANSWER_REFUSED for an answer that must not be commanded: it is not
    finite, or, if `strict`, the wrench contradicts the contacts for the second time in a row. The
    contacts that are pressed are what leads out of the box: they are to retract.
    """
    found = check_plausibility(
        judgement.plausibility, control, joints, contacts, states, judgement.wrench
    )
    if found & ANSWER_NOT_FINITE:
        return found | ANSWER_REFUSED
    if strict and found & CONTRADICTING:
        judgement.contradictions += 1
        if judgement.resumes or judgement.contradictions >= CONTRADICTIONS:
            return found | ANSWER_REFUSED
    else:
        judgement.contradictions = 0
    if found & OUTSIDE_WORKSPACE:
        for i in range(contacts.shape[0]):
            if contacts[i].answer.active:
                states[i].retract_requested = True
    return found


def plausibility_limits(config: ControllerConfig) -> Records[Plausibility]:
    """Return what a plausible answer keeps to as one record of `PLAUSIBILITY`."""
    limits = config.limits
    bounds = np.zeros(1, dtype=PLAUSIBILITY)
    bounds['friction_bound'] = config.watchdog.friction_bound
    bounds['force_ceiling'] = config.contact_state.force_ceiling
    bounds['inertia'] = config.tool.mass * LOSS_ACCELERATION
    bounds['lower'] = np.array(limits.workspace_lower or -np.inf) - BOX_EXCESS
    bounds['upper'] = np.array(limits.workspace_upper or np.inf) + BOX_EXCESS
    return bounds


def configure_monitors(config: ControllerConfig, controller: Controller) -> None:
    """
    Set the speeds beyond which an arm is too fast, and the residuals that are a collision.

    Where no thresholds are configured, that of a joint is a share of its torque limit; declared
    friction adds to it, and what the joint shows of friction as it moves. A residual that is the
    input of force control, for want of a wrist sensor, is never a collision.
    """
    limits, collision = config.limits, config.collision
    frame = controller.controls['frame']['config']
    frame['speed_limit'] = SPEED_ALARM_FACTOR * limits.operational_speed
    frame['turn_limit'] = SPEED_ALARM_FACTOR * limits.operational_turn
    joint = controller.arm.joints['config']
    joint['speed_limit'] = SPEED_ALARM_FACTOR * np.array(limits.joint_speed or np.inf)
    joint['declared_friction'] = 0.0
    joint['learnt_friction_limit'] = 0.0
    if config.wrench_input == 'momentum':
        joint['least_threshold'] = np.inf
    elif collision.threshold:
        joint['least_threshold'] = collision.threshold
    else:
        torque_limit = np.array(config.torque_limit or controller.robot.torque_limit)
        coulomb = np.array(config.friction.coulomb or 0.0)
        joint['least_threshold'] = np.maximum(
            collision.limit_share * torque_limit, LEAST_THRESHOLD
        )
        joint['declared_friction'] = collision.friction_share * coulomb
        joint['learnt_friction_limit'] = LEARNT_SHARE * torque_limit
    watch = controller.arm.joints['watch']
    watch['residual_statistics'] = 0
    watch['threshold'] = joint['least_threshold'] + joint['declared_friction']
    momentum = controller.controls['momentum']['config']
    momentum['bandwidth'] = config.momentum_bandwidth
    momentum['dynamic_share'] = collision.dynamic_share
