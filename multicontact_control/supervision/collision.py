"""What touches the arm before its wrist sensor: when it counts, and where it is."""

from __future__ import annotations

from collections import deque
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.arm_state import TOUCHED
from multicontact_control.control.controller import Controller
from multicontact_control.dynamics.robot import RobotModel
import numpy as np

COLLISION = 'collision'
LEAST_THRESHOLD = 1.0  # N m; the wrist sensor takes no less off the residual
FORGOTTEN = 1.0  # s without torques, after which nothing is known of what touched the arm
UNEVEN = 0.5  # share of a period that a sample may be early or late, to be the one after another


class CollisionWatch:
    """
    Feeds the momentum observer of a controller, and says what it finds.

    The observer needs the torque that acted since the sample before: what the robot has measured,
    or, if that is allowed, what was commanded `collision.command_delay` periods before; that may
    be a period off, so what commands change from one to the next is added to the thresholds then.
    After a sample that does not come, or has no wrench, it goes on from the next two; after a
    second without any, it forgets what it found: an operator could not end that.

    Parameters
    ----------
    config
        Thresholds, delay, names.
    controller
        Whose arm is watched.

    """

    def __init__(self, config: ControllerConfig, controller: Controller) -> None:
        joints = controller.arm.joints
        self._period, self._names = config.period, config.robot.joint_names
        self._feels = config.wrench_input != 'momentum'
        self._joints: Any = joints
        self._effort: Vector = joints['effort']
        self._doubt: Vector = joints['doubt']
        self.residual: Vector = joints['residual']
        self._threshold: Vector = joints['threshold']
        self._momentum: Any = controller.controls['momentum']
        self._elapsed: Vector = self._momentum['elapsed']
        self._controls = controller.controls
        self._by_command = config.collision.command_delay >= 0
        self._commands: deque[Vector] = deque(
            maxlen=max(config.collision.command_delay, 0) + 2)
        self._threshold[:] = collision_thresholds(config, controller.robot) if (
            self._feels) else np.inf
        self._momentum['bandwidth'] = config.momentum_bandwidth
        self._momentum['dynamic_share'] = config.collision.dynamic_share
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.residual[:], self._joints['slack'], self._momentum['collided'] = 0.0, 0.0, False
        self._elapsed[0], self._stamp = 0.0, np.nan
        self._commands.clear()
        self._farthest = -1
        self._acted = self._doubted = False
        self._unknown = 0
        self._doubt[:] = 0.0

    def commanded(self, torque: Vector) -> None:
        """Take note of a command, shape (n,) [N m]."""
        self._commands.append(torque)

    def take(self, acted: bool, added: Vector | None = None) -> None:
        """
        Take note of the torque that acted before a sample.

        Parameters
        ----------
        acted
            Whether it was measured, and is in the arm's joints.
        added
            By the arm to that, shape (n,) [N m]; None for nothing.

        """
        self._acted = acted
        if acted and added is not None:
            self._effort += added
        if self._doubted:
            self._doubt[:], self._doubted = 0.0, False
        commands = self._commands
        if self._by_command and not self._acted and len(commands) == commands.maxlen:
            before, last, after = commands[0], commands[1], commands[min(2, len(commands) - 1)]
            self._doubt[:] = np.maximum(np.abs(last - before), np.abs(after - last))
            self._effort[:], self._acted, self._doubted = last, True, True

    def look(self, stamp: float, measured: bool) -> None:
        """
        Get ready for the sample that is valid now.

        Parameters
        ----------
        stamp
            Of its joints [s].
        measured
            Whether there is a valid wrench with it.

        """
        elapsed, self._stamp = stamp - self._stamp, stamp
        follows = abs(elapsed - self._period) < UNEVEN * self._period
        known = follows and self._acted and (measured or not self._feels)
        self._elapsed[0] = elapsed if known else 0.0
        self._unknown = 0 if known else self._unknown + 1
        if self._unknown * self._period > FORGOTTEN and self._momentum['collided'].any():
            self.residual[:], self._joints['slack'], self._momentum['collided'] = 0.0, 0.0, False

    @property
    def knows(self) -> bool:
        """
        Whether the residual is of now.

        It takes two samples to begin with, as many commands as these are behind, and one more
        after a sample that did not come.
        """
        return self._unknown <= (self._commands.maxlen or 0) + 1

    def cause(self, found: int) -> str:
        """
        Return where the arm is touched, empty if it is not.

        What touches a link loads the joints before it alone: it is at, or beyond, the last joint
        whose residual has been above its threshold since it began.

        Parameters
        ----------
        found
            What `see_arm` has.

        """
        if not found & TOUCHED:
            self._farthest = -1
            return ''
        beyond = np.flatnonzero(np.abs(self.residual) > self._threshold)
        if beyond.size:
            self._farthest = max(self._farthest, int(beyond[-1]))
        return f'{COLLISION}_{self._names[max(self._farthest, 0)]}'


def collision_thresholds(config: ControllerConfig, robot: RobotModel) -> Vector:
    """Return the torque in each joint from which on something touches the arm, shape (n,)."""
    collision = config.collision
    if collision.threshold:
        return np.array(collision.threshold)
    limit = np.array(config.torque_limit) if config.torque_limit else robot.torque_limit
    coulomb = np.array(config.friction.coulomb or 0.0)
    thresholds: Vector = np.maximum(
        collision.limit_share * limit, LEAST_THRESHOLD) + (
        collision.friction_share * coulomb)
    return thresholds
