"""Torque commanded while the contacts are not controlled."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.config import SafeBehaviourConfig
from multicontact_control.dynamics.robot import RobotModel
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

    """

    def __init__(self, config: SafeBehaviourConfig, robot: RobotModel) -> None:
        self.config = config
        self._robot = robot
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
        if self._held is None:
            self._held = np.array(q, dtype=float)
        config = self.config
        if config.kind == 'zero_torque':
            return np.zeros_like(self._held)
        state = self._robot.update(q, qd)
        if config.kind == 'gravity_compensation':
            acceleration = -config.damping_rate * qd
        else:
            w = config.hold_frequency
            acceleration = w * w * (self._held - q) - 2.0 * w * qd
        torque: Vector = state.mass_matrix @ acceleration + state.coriolis + state.gravity
        return torque
