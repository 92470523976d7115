"""What supervision needs to know of the arm at every tick, and no more."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import LimitsConfig
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import LiveTerms
from multicontact_control.supervision.gate_kernels import (
    BIAS_TORQUE,
    INERTIA,
    JOINT_ROWS,
    JOINT_SPEED,
    NO_NUMBERS,
    OPERATIONAL_SPEED,
    POSTURE,
    Q,
    see_arm,
    VELOCITY,
)
import numpy as np

SPEED_EXCESS = 1.1  # times a speed limit, that the gate and the reference did not prevent
CAUSES = (('motion_operational_speed', OPERATIONAL_SPEED), ('motion_joint_speed', JOINT_SPEED))
TOO_FAST = tuple(tuple(cause for cause, bit in CAUSES if flags & bit)
                 for flags in range(JOINT_SPEED + OPERATIONAL_SPEED + 1))


class ArmState:
    """
    The arm when it was last seen, in arrays that the next look at it overwrites.

    Parameters
    ----------
    limits
        What is too fast.
    joints
        Number of joints n.

    Attributes
    ----------
    joints
        The next four as rows, shape (4, n).
    q, velocity
        Joint positions [rad] and velocities [rad/s], shape (n,).
    inertia
        Diagonal of M, shape (n,) [kg m^2].
    bias_torque
        C v + g, shape (n,) [N m].
    posture
        The next three as one record of `POSTURE`.
    pose, twist_world
        Of the operational frame.
    sensor_rotation
        Axes of the wrist sensor in world axes, shape (3, 3).
    too_fast
        Causes for a reaction: which speeds are beyond their limits.

    """

    def __init__(self, limits: LimitsConfig, joints: int) -> None:
        self.joints: Matrix = np.zeros((len(JOINT_ROWS), joints))
        self.q, self.velocity = self.joints[Q], self.joints[VELOCITY]
        self.inertia, self.bias_torque = self.joints[INERTIA], self.joints[BIAS_TORQUE]
        self.posture: Any = np.zeros(1, dtype=POSTURE)
        seen = self.posture[0]
        self.pose = Pose(seen['position'], seen['rotation'])
        self.twist_world: Vector = seen['twist']
        self.sensor_rotation: Matrix = seen['sensor_rotation']
        self.too_fast: tuple[str, ...] = ()
        self._speed_limit = SPEED_EXCESS * np.array(limits.joint_speed or [np.inf] * joints)
        self._operational = (
            SPEED_EXCESS * limits.operational_speed, SPEED_EXCESS * limits.operational_turn)

    def update(self, terms: LiveTerms, q: Vector, velocity: Vector) -> bool:
        """
        Take note of the arm.

        Parameters
        ----------
        terms
            Of its model, at this joint state.
        q, velocity
            Joint positions [rad] and velocities [rad/s], shape (n,).

        Returns
        -------
        bool
            Whether the model gives finite numbers there; if not, nothing has changed.

        """
        excess = see_arm(
            q, velocity, terms.mass_matrix, terms.bias_torque, terms.jacobian,
            terms.position_world, terms.rotation_world, terms.sensor_rotation_world,
            self._speed_limit, *self._operational, self.joints, self.posture)
        if excess == NO_NUMBERS:
            return False
        self.too_fast = TOO_FAST[excess]
        return True
