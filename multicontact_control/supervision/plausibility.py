"""Limits on the speed of the arm, and on what an answer of the control law may say."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.records import PLAUSIBILITY, Records
from multicontact_control.supervision.contacts import LOST
import numpy as np

# What `check_plausibility` returns, added up.
NOT_FINITE, PULL, SIDEWAYS, OUTSIDE = 1, 2, 4, 8
# What `check_speeds` returns, added up.
OPERATIONAL_SPEED, JOINT_SPEED = 1, 2
CAUSES = (('motion_operational_speed', OPERATIONAL_SPEED), ('motion_joint_speed', JOINT_SPEED))
TOO_FAST = tuple(tuple(cause for cause, bit in CAUSES if flags & bit) for flags in range(4))
SPEED_EXCESS = 1.1  # times a speed limit, that the gate and the reference did not prevent
BOX_EXCESS = 0.01  # m beyond the box, that the reference did not prevent


@compiled
def all_finite(values: Vector) -> bool:
    """Return whether all values are finite, shape (n,)."""
    for i in range(values.shape[0]):
        if not np.isfinite(values[i]):
            return False
    return True


@compiled
def check_speeds(joints: Any, frames: Any, speed_limit: Vector, all_bounds: Any) -> int:
    """
    Find out whether the arm is too fast.

    Parameters
    ----------
    joints
        Records of `JOINT`, shape (n,).
    frames, all_bounds
        One record each of `FRAME` and `PLAUSIBILITY`.
    speed_limit
        Of each joint, shape (n,) [rad/s].

    Returns
    -------
    int
        Sum of JOINT_SPEED and OPERATIONAL_SPEED.

    """
    frame, bounds = frames[0], all_bounds[0]
    excess = 0
    for j in range(joints.shape[0]):
        if abs(joints[j].velocity) > speed_limit[j]:
            excess = JOINT_SPEED
    speed, turn = 0.0, 0.0
    for k in range(3):
        speed += frame.twist[k] ** 2
        turn += frame.twist[3 + k] ** 2
    if speed > bounds.operational_speed ** 2 or turn > bounds.operational_turn ** 2:
        excess += OPERATIONAL_SPEED
    return excess


@compiled
def check_plausibility(
    torque: Vector, wrench: Vector, contacts: Any, states: Any, frames: Any, tools: Any,
    all_bounds: Any,
) -> int:
    """
    Find out what speaks against an answer of the control law.

    Parameters
    ----------
    torque
        The answer, Gamma, shape (n,) [N m].
    wrench
        Reading of the wrist sensor, shape (6,) [N, N m].
    contacts, states
        Records of `CONTACT` and `CONTACT_STATE`, shape (r,). A tool that is braked after its
        surface has gone reads its own inertia, as a pull: for a lost contact there is an
        allowance.
    frames, tools, all_bounds
        One record each of `FRAME`, `TOOL` and `PLAUSIBILITY`.

    Returns
    -------
    int
        Sum of NOT_FINITE, PULL (a surface that pulls), SIDEWAYS (more than friction can explain)
        and OUTSIDE (the operational point is out of its box).

    """
    frame, tool, bounds = frames[0], tools[0], all_bounds[0]
    found = 0
    if not all_finite(torque):
        found = NOT_FINITE
    pressed = 0.0
    for i in range(contacts.shape[0]):
        contact = contacts[i]
        if not np.isfinite(
                contact.alpha_meas + contact.alpha_des + contact.alpha_est
                + contact.alpha_rate_est + contact.innovation + contact.prior_variance
                + contact.variance_used):
            found |= NOT_FINITE
        pressed += abs(contact.alpha_meas)
        allowed = bounds.pull_threshold
        if states[i].state == LOST:
            allowed += bounds.inertia
        if contact.alpha_meas < -allowed:
            found |= PULL
    sideways = 0.0
    for k in range(3):
        force = tool.weight[k]
        for j in range(3):
            force += frame.sensor_rotation[k, j] * (wrench[j] - tool.bias[j])
        for i in range(contacts.shape[0]):
            force -= contacts[i].alpha_meas * contacts[i].normal[k]
        sideways += force * force
        if frame.position[k] < bounds.box[0, k] or frame.position[k] > bounds.box[1, k]:
            found |= OUTSIDE
    bound = bounds.friction_offset + bounds.friction_bound * pressed
    if sideways > bound * bound:
        found |= SIDEWAYS
    return found


def plausibility_limits(config: ControllerConfig) -> Records:
    """Return what an answer must be like as one record of `PLAUSIBILITY`."""
    bounds = np.zeros(1, dtype=PLAUSIBILITY)
    for name in ('pull_threshold', 'friction_bound', 'friction_offset'):
        bounds[name] = getattr(config.watchdog, name)
    bounds['inertia'] = config.tool.mass * config.watchdog.loss_acceleration
    limits, everywhere = config.limits, np.full(3, np.inf)
    bounds['box'] = (
        np.array(limits.workspace_lower or -everywhere) - BOX_EXCESS,
        np.array(limits.workspace_upper or everywhere) + BOX_EXCESS)
    for name in ('operational_speed', 'operational_turn'):
        bounds[name] = SPEED_EXCESS * getattr(limits, name)
    return bounds
