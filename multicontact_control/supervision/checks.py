"""
What an answer of the control law is checked for, and which residual is a collision.

Causes of the checks, as those of the inputs in `inputs`, are named `<part>_<what>`: `motion`
(`operational_speed`, `joint_speed`), `wrench` (`pull`, `sideways`, `stray`), `law` (`not_finite`,
or the error it raises), `collision` (the joint that it loads last), `start` (`outside`) and
`internal` (an error of the supervision itself).
"""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import dot
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.wrench import operational_wrench
from multicontact_control.control.arm import JOINT_SPEED, OPERATIONAL_SPEED
from multicontact_control.control.controller import Controller
from multicontact_control.records import PLAUSIBILITY, Records
from multicontact_control.supervision.contacts import FREE, LOST
from multicontact_control.supervision.reactions import NONE, SEVERITY
import numpy as np

# What `check_plausibility` returns, added up.
NOT_FINITE, PULL, SIDEWAYS, OUTSIDE, STRAY = 1, 2, 4, 8, 16
WRONG_WRENCH = {PULL: 'wrench_pull', STRAY: 'wrench_stray', SIDEWAYS: 'wrench_sideways'}
COLLISION, CONTRADICTED = 'collision', 'joints_velocity'
SPEEDS = (('motion_operational_speed', OPERATIONAL_SPEED), ('motion_joint_speed', JOINT_SPEED))
TOO_FAST = tuple(tuple(cause for cause, bit in SPEEDS if flags & bit) for flags in range(32))

PULL_LIMIT = 4.0  # N, measured pull of a surface that is accepted
READ_PULL_LIMIT = 8.0  # N, pull that is read and accepted with what is taken off as no force
LOSS_ACCELERATION = 20.0  # m/s^2, of a tool that is braked after a contact is lost
SIDEWAYS_LIMIT = 5.0  # N of sideways force that is always accepted
SPEED_EXCESS = 1.1  # times a speed limit, beyond which gate and reference have failed
BOX_EXCESS = 0.01  # m beyond the workspace, where the reference has failed
# The smallest threshold [N m], and the largest share of the limit that friction adds to it.
LEAST_THRESHOLD, LEARNT_SHARE = 1.0, 0.1


def reaction_to(causes: tuple[str, ...], config: ControllerConfig) -> str:
    """Return the severest reaction that causes call for, each by its name or its part's."""
    to = {
        'joints': 'float', CONTRADICTED: 'hold', 'wrench': 'hold', 'variance': 'inflate',
        'clock': 'hold', 'motion': 'hold', 'law': 'hold', 'start': 'hold',
        COLLISION: config.collision.reaction}
    called_for = [to.get(cause, to[cause.split('_')[0]]) for cause in causes]
    return max(called_for, key=SEVERITY.index, default=NONE)


@compiled
def check_plausibility(
    limits: Any, controls: Any, joints: Any, contacts: Any, states: Any,
) -> int:
    """
    Check the answer of the control law that is in the joints.

    Returns the sum of NOT_FINITE, PULL (a surface pulls, beyond what was read before; after the
    loss of a contact the inertia of the tool that is braked is allowed for), SIDEWAYS (more than
    friction can explain), STRAY (a contact that is free is beyond the force ceiling) and OUTSIDE
    (the operational point is out of its box).
    """
    bounds, control, flags = limits[0], controls[0], 0
    if not np.isfinite(joints['torque']).all():
        flags = NOT_FINITE
    wrench, pressed = np.zeros(6), 0.0
    operational_wrench(control, wrench)
    sideways = wrench[:3]
    for i in range(contacts.shape[0]):
        contact, answer = contacts[i], contacts[i].answer
        if not np.isfinite(
                contact.alpha_meas + answer.alpha_des + answer.alpha_est + answer.alpha_rate_est
                + answer.innovation + answer.prior_variance + answer.variance_used):
            flags |= NOT_FINITE
        if contact.config.leader != i:
            continue
        pressed += abs(contact.alpha_meas)
        sideways -= (contact.alpha_meas + contact.untared) * contact.normal
        allowance = bounds.inertia if states[i].state == LOST else 0.0
        # What a free contact is read with is what its search begins with.
        known = min(states[i].baseline, 0.0) if states[i].state == FREE else 0.0
        if contact.alpha_meas - known < -(PULL_LIMIT + allowance) or (
                contact.alpha_meas + contact.untared < -(READ_PULL_LIMIT + allowance)):
            flags |= PULL
        if contact.alpha_meas > bounds.force_ceiling and states[i].state == FREE:
            flags |= STRAY
    if np.sqrt(dot(sideways, sideways)) > SIDEWAYS_LIMIT + bounds.friction_bound * pressed:
        flags |= SIDEWAYS
    place, box = control.frame.position, bounds.box
    if (place < box[0]).any() or (place > box[1]).any():
        flags |= OUTSIDE
    return flags


def plausibility_limits(config: ControllerConfig) -> Records:
    """Return what an answer must be like as one record of `PLAUSIBILITY`."""
    bounds = np.zeros(1, dtype=PLAUSIBILITY)
    bounds['friction_bound'] = config.watchdog.friction_bound
    bounds['force_ceiling'] = config.contact_state.force_ceiling
    bounds['inertia'] = config.tool.mass * LOSS_ACCELERATION
    limits = config.limits
    bounds['box'] = (np.array(limits.workspace_lower or [-np.inf] * 3) - BOX_EXCESS,
                     np.array(limits.workspace_upper or [np.inf] * 3) + BOX_EXCESS)
    return bounds


def watch_arm(config: ControllerConfig, controller: Controller) -> None:
    """Set the speeds beyond which an arm is too fast, and the residuals that are a collision."""
    limits, collision, joints = config.limits, config.collision, controller.arm.joints
    momentum, frame = controller.controls['momentum'], controller.controls['frame']
    joints['speed_limit'] = SPEED_EXCESS * np.array(limits.joint_speed or np.inf)
    frame['speed_limit'] = SPEED_EXCESS * limits.operational_speed
    frame['turn_limit'] = SPEED_EXCESS * limits.operational_turn
    joints['evidence'] = joints['allowance'] = joints['learnt_limit'] = 0
    least = np.inf if config.wrench_input == 'momentum' else np.array(collision.threshold)
    if not np.size(least):
        limit = np.array(config.torque_limit or controller.robot.torque_limit)
        least = np.maximum(collision.limit_share * limit, LEAST_THRESHOLD)
        joints['allowance'] = collision.friction_share * np.array(config.friction.coulomb or 0.0)
        joints['learnt_limit'] = LEARNT_SHARE * limit
    joints['least_threshold'], joints['threshold'] = least, least + joints['allowance']
    momentum['bandwidth'] = config.momentum_bandwidth
    momentum['dynamic_share'] = collision.dynamic_share
