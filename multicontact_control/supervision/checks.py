"""
What an answer of the control law is checked for, and which residual is a collision.

Causes of the checks, as those of the inputs in `inputs`, are named `<part>_<what>`: `motion`
(`operational_speed`, `joint_speed`), `wrench` (`pull`, `sideways`, `stray`), `law` (`not_finite`,
or the error it raises), `collision` (the joint that it loads last), `start` (`outside`) and
`internal` (an error of the supervision itself).
"""

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
    JOINT_SPEED,
    OPERATIONAL_SPEED,
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
from multicontact_control.supervision.reactions import NONE, SEVERITY
import numpy as np

WRONG_WRENCH = {
    SURFACE_PULLS: 'wrench_pull',
    FORCE_STRAY: 'wrench_stray',
    FORCE_SIDEWAYS: 'wrench_sideways',
}
CONTRADICTING = SURFACE_PULLS | FORCE_STRAY | FORCE_SIDEWAYS
CONTRADICTIONS = (
    2  # samples in a row that contradict the contacts, for the wrench to be refused
)
COLLISION, CONTRADICTED = 'collision', 'joints_velocity'
TOO_FAST = {
    OPERATIONAL_SPEED: 'motion_operational_speed',
    JOINT_SPEED: 'motion_joint_speed',
}

PULL_LIMIT = 4.0  # N, measured pull of a surface that is accepted
READ_PULL_LIMIT = (
    8.0  # N, pull that is read and accepted with what is taken off as no force
)
LOSS_ACCELERATION = 20.0  # m/s^2, of a tool that is braked after a contact is lost
SIDEWAYS_LIMIT = 5.0  # N of sideways force that is always accepted
SPEED_ALARM_FACTOR = (
    1.1  # times a speed limit, beyond which gate and reference have failed
)
BOX_EXCESS = 0.01  # m beyond the workspace, where the reference has failed
# The smallest threshold [N m], and the largest share of the limit that friction adds to it.
LEAST_THRESHOLD, LEARNT_SHARE = 1.0, 0.1


class Plausibility(Record, Protocol):
    """What an answer of the law must be like; one."""

    inertia: float  # what a lost contact may read more: the tool's inertia [N]
    friction_bound: float  # force across the normals, per force along them
    force_ceiling: float  # along them, of contacts that are not commanded [N]

    # Where the operational point may be [m].
    lower: Annotated[Vector, 3]
    upper: Annotated[Vector, 3]


PLAUSIBILITY = record_dtype(Plausibility)


class Judgement(Record, Protocol):
    """How answers have been judged; one."""

    plausibility: Plausibility

    # Whether the law has not been in control, so that one sample is enough.
    resumes: bool

    contradictions: int  # in a row

    # At the operational point, less what the contacts explain [N, N m].
    wrench: Annotated[Vector, 6]


JUDGEMENT = record_dtype(Judgement)


def choose_severest_reaction(causes: tuple[str, ...], config: ControllerConfig) -> str:
    """Return the severest reaction that causes call for, each by its name or its part's."""
    to = {
        'joints': 'float',
        CONTRADICTED: 'hold',
        'wrench': 'hold',
        'variance': 'inflate',
        'clock': 'hold',
        'motion': 'hold',
        'law': 'hold',
        'start': 'hold',
        COLLISION: config.collision.reaction,
    }
    called_for = [to.get(cause, to[cause.split('_')[0]]) for cause in causes]
    return max(called_for, key=SEVERITY.index, default=NONE)


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

    `wrench`, shape (6,), is overwritten. Returns the sum of ANSWER_NOT_FINITE, SURFACE_PULLS
    (beyond what was read before; after the loss of a contact the inertia of the tool that is
    braked is allowed for), FORCE_SIDEWAYS (more than friction can explain), FORCE_STRAY (a contact
    that is free is beyond the force ceiling) and OUTSIDE_WORKSPACE (of the operational point).
    """
    flags, pressed, sideways = 0, 0.0, wrench[:3]
    for j in range(joints.shape[0]):
        if not np.isfinite(joints[j].answer.torque):
            flags = ANSWER_NOT_FINITE
    operational_wrench(control, wrench)
    for i in range(contacts.shape[0]):
        contact, answer = contacts[i], contacts[i].answer
        if not np.isfinite(
            contact.alpha_meas
            + answer.alpha_des
            + answer.alpha_est
            + answer.alpha_rate_est
            + answer.innovation
            + answer.prior_variance
            + answer.variance_used
        ):
            flags |= ANSWER_NOT_FINITE
        if contact.config.leader != i:
            continue
        pressed += abs(contact.alpha_meas)
        add_scaled_vector(
            sideways, -(contact.alpha_meas + contact.untared), contact.normal
        )
        allowance = known = 0.0
        if states[i].state == LOST:
            allowance = bounds.inertia
        if (
            states[i].state == FREE
        ):  # what it is read with is what its search begins with
            known = min(states[i].baseline, 0.0)
        if contact.alpha_meas - known < -(PULL_LIMIT + allowance) or (
            contact.alpha_meas + contact.untared < -(READ_PULL_LIMIT + allowance)
        ):
            flags |= SURFACE_PULLS
        if contact.alpha_meas > bounds.force_ceiling and states[i].state == FREE:
            flags |= FORCE_STRAY
    if vector_length(sideways) > SIDEWAYS_LIMIT + bounds.friction_bound * pressed:
        flags |= FORCE_SIDEWAYS
    place = control.frame.position
    for k in range(3):
        if place[k] < bounds.lower[k] or place[k] > bounds.upper[k]:
            flags |= OUTSIDE_WORKSPACE
    return flags


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

    ANSWER_REFUSED is added to what that returns if the answer is not to be commanded: it is not
    finite, or, if `strict`, the wrench contradicts the contacts for the second time in a row. The
    contacts that are pressed lead out of the box: they are to retract.
    """
    doubts = check_plausibility(
        judgement.plausibility, control, joints, contacts, states, judgement.wrench
    )
    if doubts & ANSWER_NOT_FINITE:
        return doubts | ANSWER_REFUSED
    contradicts = strict and doubts & CONTRADICTING != 0
    judgement.contradictions = judgement.contradictions + 1 if contradicts else 0
    if contradicts and (
        judgement.contradictions >= CONTRADICTIONS or judgement.resumes
    ):
        return doubts | ANSWER_REFUSED
    if doubts & OUTSIDE_WORKSPACE:
        for i in range(contacts.shape[0]):
            states[i].retract_requested = (
                states[i].retract_requested or contacts[i].answer.active
            )
    return doubts


def name_refusal_cause(found: int) -> str:
    """Return the cause by which an answer is refused."""
    if found & ANSWER_NOT_FINITE:
        return 'law_not_finite'
    return next(cause for flag, cause in WRONG_WRENCH.items() if found & flag)


def plausibility_limits(config: ControllerConfig) -> Records[Plausibility]:
    """Return what an answer must be like as one record of `PLAUSIBILITY`."""
    bounds = np.zeros(1, dtype=PLAUSIBILITY)
    bounds['friction_bound'] = config.watchdog.friction_bound
    bounds['force_ceiling'] = config.contact_state.force_ceiling
    bounds['inertia'] = config.tool.mass * LOSS_ACCELERATION
    limits = config.limits
    bounds['lower'] = np.array(limits.workspace_lower or [-np.inf] * 3) - BOX_EXCESS
    bounds['upper'] = np.array(limits.workspace_upper or [np.inf] * 3) + BOX_EXCESS
    return bounds


def configure_monitors(config: ControllerConfig, controller: Controller) -> None:
    """Set the speeds beyond which an arm is too fast, and the residuals that are a collision."""
    limits, collision, joints = config.limits, config.collision, controller.arm.joints
    momentum, frame = controller.controls['momentum'], controller.controls['frame']
    joint, watch = joints['config'], joints['watch']
    joint['speed_limit'] = SPEED_ALARM_FACTOR * np.array(limits.joint_speed or np.inf)
    frame['config']['speed_limit'] = SPEED_ALARM_FACTOR * limits.operational_speed
    frame['config']['turn_limit'] = SPEED_ALARM_FACTOR * limits.operational_turn
    watch['residual_statistics'] = joint['declared_friction'] = joint[
        'learnt_friction_limit'
    ] = 0
    least = (
        np.inf if config.wrench_input == 'momentum' else np.array(collision.threshold)
    )
    if not np.size(least):
        limit = np.array(config.torque_limit or controller.robot.torque_limit)
        least = np.maximum(collision.limit_share * limit, LEAST_THRESHOLD)
        joint['declared_friction'] = collision.friction_share * np.array(
            config.friction.coulomb or 0.0
        )
        joint['learnt_friction_limit'] = LEARNT_SHARE * limit
    joint['least_threshold'], watch['threshold'] = (
        least,
        least + joint['declared_friction'],
    )
    momentum['config']['bandwidth'] = config.momentum_bandwidth
    momentum['config']['dynamic_share'] = collision.dynamic_share
