"""
What an answer of the control law is checked for, and what touches the arm.

Causes of the checks, as those of the inputs in `inputs`, are named `<part>_<what>`: `motion`
(`operational_speed`, `joint_speed`), `wrench` (`pull`, `sideways`), `law` (`not_finite`, or the
error it raises), `collision` (the joint that it loads last), `start` (`outside`) and `internal`
(an error of the supervision itself).
"""

from __future__ import annotations

from collections import deque
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm import JOINT_SPEED, OPERATIONAL_SPEED, TOUCHED
from multicontact_control.control.controller import Controller
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.records import PLAUSIBILITY, Records
from multicontact_control.supervision.contacts import LOST
from multicontact_control.supervision.inputs import Inputs
import numpy as np

# What `check_plausibility` returns, added up.
NOT_FINITE, PULL, SIDEWAYS, OUTSIDE = 1, 2, 4, 8
COLLISION = 'collision'
SPEEDS = (('motion_operational_speed', OPERATIONAL_SPEED), ('motion_joint_speed', JOINT_SPEED))
TOO_FAST = tuple(tuple(cause for cause, bit in SPEEDS if flags & bit) for flags in range(4))

PULL_LIMIT = 4.0  # N, measured pull of a surface that is accepted
LOSS_ACCELERATION = 20.0  # m/s^2, of a tool that is braked after a contact is lost
SIDEWAYS_LIMIT = 5.0  # N of sideways force that is always accepted
SPEED_EXCESS = 1.1  # times a speed limit, beyond which gate and reference have failed
BOX_EXCESS = 0.01  # m beyond the workspace, where the reference has failed
LEAST_THRESHOLD = 1.0  # N m; the wrist sensor takes no less off the residual
FORGOTTEN = 1.0  # s without known torques, after which a collision is forgotten
UNEVEN = 0.5  # periods that a sample may be early or late and still be the next one


def reactions_of(config: ControllerConfig) -> dict[str, str]:
    """Return the reaction to each part that has failed, by what the causes begin with."""
    return {
        'joints': config.watchdog.on_joint_fault, 'wrench': config.watchdog.on_wrench_fault,
        'variance': 'inflate', 'clock': 'hold', 'motion': 'hold', 'law': 'hold', 'start': 'hold',
        COLLISION: config.collision.reaction}


@compiled
def check_plausibility(
    limits: Any, controls: Any, joints: Any, contacts: Any, states: Any,
) -> int:
    """
    Check the answer of the control law that is in the joints.

    Returns the sum of NOT_FINITE, PULL (a surface pulls; after the loss of a contact the inertia
    of the tool that is braked is allowed for), SIDEWAYS (more than friction can explain) and
    OUTSIDE (the operational point is out of its box).
    """
    bounds, control = limits[0], controls[0]
    frame, tool = control.frame, control.tool
    found = 0
    for j in range(joints.shape[0]):
        if not np.isfinite(joints[j].torque):
            found = NOT_FINITE
    pressed = 0.0
    for i in range(contacts.shape[0]):
        contact, answer = contacts[i], contacts[i].answer
        if not np.isfinite(
                contact.alpha_meas + answer.alpha_des + answer.alpha_est + answer.alpha_rate_est
                + answer.innovation + answer.prior_variance + answer.variance_used):
            found |= NOT_FINITE
        if contact.leader != i:
            continue
        pressed += abs(contact.alpha_meas)
        allowance = bounds.inertia if states[i].state == LOST else 0.0
        if contact.alpha_meas < -(PULL_LIMIT + allowance):
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
    bound = SIDEWAYS_LIMIT + bounds.friction_bound * pressed
    if sideways > bound * bound:
        found |= SIDEWAYS
    return found


def plausibility_limits(config: ControllerConfig) -> Records:
    """Return what an answer must be like as one record of `PLAUSIBILITY`."""
    bounds = np.zeros(1, dtype=PLAUSIBILITY)
    bounds['friction_bound'] = config.watchdog.friction_bound
    bounds['inertia'] = config.tool.mass * LOSS_ACCELERATION
    limits, everywhere = config.limits, np.full(3, np.inf)
    bounds['box'] = (
        np.array(limits.workspace_lower or -everywhere) - BOX_EXCESS,
        np.array(limits.workspace_upper or everywhere) + BOX_EXCESS)
    return bounds


def limit_speeds(joints: Records, frames: Records, config: ControllerConfig) -> None:
    """Fill records of `JOINT` and `FRAME` with the speeds beyond which the arm is too fast."""
    limits = config.limits
    joints['speed_limit'] = SPEED_EXCESS * np.array(limits.joint_speed or np.inf)
    frames['speed_limit'] = SPEED_EXCESS * limits.operational_speed
    frames['turn_limit'] = SPEED_EXCESS * limits.operational_turn


class CollisionWatch:
    """
    Feeds the momentum observer of a controller, and names the joint where the arm is touched.

    The observer needs the torque that acted since the sample before: the measured one, or, if
    `collision.command_delay` says so, the command of that many periods before. That may be one
    period off, so the difference between successive commands is added to the thresholds then.

    Parameters
    ----------
    config
        Thresholds, delay, names.
    controller
        Whose arm is watched.

    Attributes
    ----------
    residual
        Torque in each joint of what touches the arm, shape (n,) [N m].

    """

    def __init__(self, config: ControllerConfig, controller: Controller) -> None:
        self._period, self._names = config.period, config.robot.joint_names
        self._feels = config.wrench_input != 'momentum'
        self._joints, self._momentum = controller.arm.joints, controller.controls['momentum']
        self._elapsed: Vector = self._momentum['elapsed']
        self._adds_gravity = config.robot.adds_gravity
        self.residual: Vector = self._joints['residual']
        self._joints['threshold'] = collision_thresholds(config, controller.robot) if (
            self._feels) else np.inf
        self._momentum['bandwidth'] = config.momentum_bandwidth
        self._momentum['dynamic_share'] = config.collision.dynamic_share
        delay = config.collision.command_delay
        self._by_command, self._needed = delay >= 0, max(delay, 0) + 2
        self._commands: deque[Vector] = deque(maxlen=self._needed)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._forget_collision()
        self._elapsed[0], self._joints['doubt'], self._stamp = 0.0, 0.0, np.nan
        self._commands.clear()
        self._farthest, self._unknown = -1, 0

    def _forget_collision(self) -> None:
        self.residual[:], self._joints['slack'], self._momentum['collided'] = 0.0, 0.0, False

    def commanded(self, torque: Vector) -> None:
        """Take note of a command, shape (n,) [N m]."""
        self._commands.append(torque)

    def look(self, inputs: Inputs, *, measured: bool) -> None:
        """Get ready for the newest sample of an input stage, which has a valid wrench or not."""
        joints, commands, acted = self._joints, self._commands, inputs.acted
        if self._by_command:
            joints['doubt'] = 0.0
        if acted:
            if self._adds_gravity:
                joints['effort'] += joints['added']
        elif self._by_command and len(commands) == self._needed:
            before, last, after = commands[0], commands[1], commands[min(2, self._needed - 1)]
            joints['doubt'] = np.maximum(np.abs(last - before), np.abs(after - last))
            joints['effort'], acted = last, True
        stamp = inputs.joint_stamp
        elapsed, self._stamp = stamp - self._stamp, stamp
        follows = abs(elapsed - self._period) < UNEVEN * self._period
        known = follows and acted and (measured or not self._feels)
        self._elapsed[0] = elapsed if known else 0.0
        self._unknown = 0 if known else self._unknown + 1
        if self._unknown * self._period > FORGOTTEN and self._momentum['collided'].any():
            self._forget_collision()  # it would block the arm for good
        inputs.estimate_known = self._unknown <= self._needed + 1  # it takes as many to begin

    def cause(self, found: int) -> str:
        """
        Return where the arm is touched, by what `see_arm` has found; empty if it is not.

        What touches a link loads no joint beyond it: it is at, or beyond, the last joint whose
        residual has been above its threshold since it began.
        """
        if not found & TOUCHED:
            self._farthest = -1
            return ''
        beyond = np.flatnonzero(np.abs(self.residual) > self._joints['threshold'])
        if beyond.size:
            self._farthest = max(self._farthest, int(beyond[-1]))
        return f'{COLLISION}_{self._names[max(self._farthest, 0)]}'


def collision_thresholds(config: ControllerConfig, robot: RobotModel) -> Vector:
    """Return the torque in each joint from which on something touches the arm, shape (n,)."""
    collision = config.collision
    if collision.threshold:
        return np.array(collision.threshold)
    limit = np.array(config.torque_limit) if config.torque_limit else robot.torque_limit
    friction: Vector = collision.friction_share * np.array(config.friction.coulomb or 0.0)
    return np.maximum(collision.limit_share * limit, LEAST_THRESHOLD) + friction
