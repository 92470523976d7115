"""What the drives do without commands: they hold their position."""

from __future__ import annotations

from multicontact_control.arrays import Vector
import numpy as np
import pinocchio as pin
from sim_bridge.kinematics import mass_matrix

FREQUENCY = 20.0  # w [rad/s]


class PositionHold:
    """
    A gravity-compensated, critically damped joint servo: M (w^2 (q_0 - q) - 2 w qd) + g.

    Parameters
    ----------
    model
        The arm, tool and rotors included.

    """

    def __init__(self, model: pin.Model) -> None:
        self._model, self._data = model, model.createData()
        self._posture: Vector | None = None

    @property
    def holding(self) -> bool:
        """Whether it is at work."""
        return self._posture is not None

    def end(self) -> None:
        """Let go: the next torque begins anew."""
        self._posture = None

    def torque(self, q: Vector, qd: Vector) -> Vector:
        """
        Return the torque that holds the posture in which it was first asked for.

        Parameters
        ----------
        q, qd
            Joint positions [rad] and velocities [rad/s], shape (n,).

        Returns
        -------
        Vector
            Shape (n,) [N m].

        """
        if self._posture is None:
            self._posture = q.copy()
        w = FREQUENCY
        acceleration = w * w * (self._posture - q) - 2.0 * w * qd
        still = np.zeros_like(q)
        gravity = pin.rnea(self._model, self._data, q, still, still)
        torque: Vector = mass_matrix(self._model, self._data, q) @ acceleration + gravity
        return torque
