"""Limits on the speed of the arm, and on what an answer of the control law may say."""

from __future__ import annotations

from typing import Any

from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm_state import JOINT_SPEED, OPERATIONAL_SPEED
from multicontact_control.records import PLAUSIBILITY, Records
from multicontact_control.supervision.contacts import LOST
import numpy as np

# What `check_plausibility` returns, added up.
NOT_FINITE, PULL, SIDEWAYS, OUTSIDE = 1, 2, 4, 8
CAUSES = (('motion_operational_speed', OPERATIONAL_SPEED), ('motion_joint_speed', JOINT_SPEED))
TOO_FAST = tuple(tuple(cause for cause, bit in CAUSES if flags & bit) for flags in range(4))
FRICTION_OFFSET = 5.0  # N of sideways force that is always accepted
LOSS_ACCELERATION = 20.0  # m/s^2, of a tool that is braked after a contact is lost
SPEED_EXCESS = 1.1  # times a speed limit, that the gate and the reference did not prevent
BOX_EXCESS = 0.01  # m beyond the box, that the reference did not prevent


@compiled
def check_plausibility(
    bounds: Any, control: Any, joints: Any, contacts: Any, states: Any,
) -> int:
    """
    Find out what speaks against the answer of the control law that is in the joints.

    Returns the sum of NOT_FINITE, PULL (a surface that pulls), SIDEWAYS (more than friction can
    explain) and OUTSIDE (the operational point is out of its box). A tool that is braked after
    its surface has gone reads its own inertia, as a pull: a lost contact has an allowance.
    """
    frame, tool = control.frame, control.tool
    found = 0
    for j in range(joints.shape[0]):
        if not np.isfinite(joints[j].torque):
            found = NOT_FINITE
    pressed = 0.0
    for i in range(contacts.shape[0]):
        contact = contacts[i]
        if not np.isfinite(
                contact.alpha_meas + contact.alpha_des + contact.alpha_est
                + contact.alpha_rate_est + contact.innovation + contact.prior_variance
                + contact.variance_used):
            found |= NOT_FINITE
        allowed = bounds.pull_threshold
        if states[i].state == LOST:
            allowed += bounds.inertia
        if states[i].couple:
            continue
        pressed += abs(contact.alpha_meas)
        if contact.alpha_meas < -allowed:
            found |= PULL
    sideways = 0.0
    for k in range(3):
        force = tool.weight[k]
        for j in range(3):
            force += frame.sensor_rotation[k, j] * (control.wrench[j] - tool.bias[j])
        for i in range(contacts.shape[0]):
            force -= contacts[i].alpha_meas * contacts[i].normal[k]
        sideways += force * force
        if frame.position[k] < bounds.box[0, k] or frame.position[k] > bounds.box[1, k]:
            found |= OUTSIDE
    bound = FRICTION_OFFSET + bounds.friction_bound * pressed
    if sideways > bound * bound:
        found |= SIDEWAYS
    return found


def plausibility_limits(config: ControllerConfig) -> Records:
    """Return what an answer must be like as one record of `PLAUSIBILITY`."""
    bounds = np.zeros(1, dtype=PLAUSIBILITY)
    bounds['pull_threshold'] = config.watchdog.pull_threshold
    bounds['friction_bound'] = config.watchdog.friction_bound
    bounds['inertia'] = config.tool.mass * LOSS_ACCELERATION
    limits, everywhere = config.limits, np.full(3, np.inf)
    bounds['box'] = (
        np.array(limits.workspace_lower or -everywhere) - BOX_EXCESS,
        np.array(limits.workspace_upper or everywhere) + BOX_EXCESS)
    return bounds


def limit_speeds(joints: Records, frames: Records, config: ControllerConfig) -> None:
    """Say in records of `JOINT` and `FRAME` from which speeds on the arm is too fast."""
    limits = config.limits
    joints['speed_limit'] = SPEED_EXCESS * np.array(limits.joint_speed or np.inf)
    frames['speed_limit'] = SPEED_EXCESS * limits.operational_speed
    frames['turn_limit'] = SPEED_EXCESS * limits.operational_turn
