"""Torque commanded while the contacts are not controlled."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.config import SafeBehaviourConfig
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.supervision.own_weight import OwnWeight
import numpy as np


class SafeBehaviour:
    """
    Gravity compensation with damping, zero torque, or the posture held; needs no wrench.

    Parameters
    ----------
    config
        Which, and how stiff.
    robot
        The arm.
    own_weight
        What its drives add to a command, None if nothing.

    """

    def __init__(
        self, config: SafeBehaviourConfig, robot: RobotModel, own_weight: OwnWeight | None = None,
    ) -> None:
        self.config = config
        self._robot, self._own_weight = robot, own_weight
        self._held: Vector | None = None

    def start(self) -> None:
        """Take the posture of the next sample for the one to hold."""
        self._held = None

    def torque(self, q: Vector, qd: Vector) -> Vector:
        """
        Return the joint torque for a sample.

        Parameters
        ----------
        q, qd
            Joint positions [rad] and velocities [rad/s], shape (n,).

        Returns
        -------
        Vector
            Shape (n,) [N m].

        """
        config = self.config
        if config.kind != 'hold_position':
            self._held = None  # the arm may be moved away before a posture is to be held
        elif self._held is None:
            self._held = np.array(q, dtype=float)
        if config.kind == 'zero_torque':  # of what is commanded
            return np.zeros_like(q) if self._own_weight is None else (
                self._own_weight.torque.copy())
        state = self._robot.update(q, qd)
        if self._held is None:
            acceleration = -config.damping_rate * qd
        else:
            w = config.hold_frequency
            acceleration = w * w * (self._held - q) - 2.0 * w * qd
        torque: Vector = state.mass_matrix @ acceleration + state.coriolis + state.gravity
        return torque
