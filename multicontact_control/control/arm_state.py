"""Where the arm is and what its model says there, as the law and its supervision share it."""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import copy_matrix, copy_vector
from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.compiled import compiled
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.records import FRAME, JOINT
import numpy as np


@compiled
def fill_joints(
    q: Vector, velocity: Vector, mass_matrix: Matrix, bias_torque: Vector, joints: Any,
) -> bool:
    """
    Fill in the joints, unless the model gives no finite numbers there.

    Parameters
    ----------
    q, velocity
        Shape (n,) [rad, rad/s].
    mass_matrix, bias_torque
        M, shape (n, n) [kg m^2], and C v + g, shape (n,) [N m].
    joints
        Records of `JOINT`, shape (n,).

    Returns
    -------
    bool
        Whether all numbers are finite; if not, nothing has changed.

    """
    for j in range(joints.shape[0]):
        if not np.isfinite(bias_torque[j]):
            return False
    for j in range(joints.shape[0]):
        joint = joints[j]
        joint.q = q[j]
        joint.velocity = velocity[j]
        joint.inertia = mass_matrix[j, j]
        joint.bias_torque = bias_torque[j]
    return True


@compiled
def fill_frame(
    velocity: Vector, jacobian: Matrix, position: Vector, rotation: Matrix,
    sensor_position: Vector, sensor_rotation: Matrix, frames: Any,
) -> None:
    """
    Fill in pose and twist of the operational frame, and the pose of the sensor.

    Parameters
    ----------
    velocity, jacobian
        v, shape (n,) [rad/s], and J, shape (6, n).
    position, rotation, sensor_position, sensor_rotation
        World axes, shapes (3,) [m] and (3, 3).
    frames
        One record of `FRAME`.

    """
    frame = frames[0]
    copy_vector(position, frame.position)
    copy_matrix(rotation, frame.rotation)
    copy_vector(sensor_position, frame.sensor_position)
    copy_matrix(sensor_rotation, frame.sensor_rotation)
    for i in range(6):
        total = 0.0
        for j in range(velocity.shape[0]):
            total += jacobian[i, j] * velocity[j]
        frame.twist[i] = total


class ArmState:
    """
    The arm when its joints were last given, in arrays that the next `update` overwrites.

    Parameters
    ----------
    robot
        Its model.

    Attributes
    ----------
    q, velocity
        Joint positions [rad] and velocities [rad/s], shape (n,).
    joints
        Records of `JOINT`, shape (n,).
    frames
        One record of `FRAME`.
    inertia, bias_torque
        Diagonal of M [kg m^2] and C v + g [N m], in `joints`, shape (n,).
    pose, twist_world, sensor_rotation
        Of the operational frame and the sensor, in `frames`.
    finite
        Whether the model gave finite numbers for the joints that were given last. If not, the
        arm is where it was before.

    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self._shape = (robot.joint_count,)
        self.q, self.velocity = np.zeros(self._shape), np.zeros(self._shape)
        self.joints: Any = np.zeros(self._shape, dtype=JOINT)
        self.frames: Any = np.zeros(1, dtype=FRAME)
        self.inertia: Vector = self.joints['inertia']
        self.bias_torque: Vector = self.joints['bias_torque']
        frame = self.frames[0]
        self.pose = Pose(frame['position'], frame['rotation'])
        self.twist_world: Vector = frame['twist']
        self.sensor_rotation: Matrix = frame['sensor_rotation']
        self.finite = False
        self.update(self.q, self.velocity)

    def update(self, q: Vector, velocity: Vector) -> bool:
        """
        Take in where the arm is.

        Parameters
        ----------
        q, velocity
            Joint positions [rad] and velocities [rad/s], shape (n,).

        Returns
        -------
        bool
            Whether the model gives finite numbers there; if not, the arm stays where it was.

        Raises
        ------
        ShapeError
            If an array is not of the robot's size.

        """
        if q.shape != self._shape or velocity.shape != self._shape:
            require_shape('q', q, self._shape)
            require_shape('qd', velocity, self._shape)
        self.q[:] = q  # whatever its layout: numba would compile anew for another one
        self.velocity[:] = velocity
        terms = self.robot.compute(self.q, self.velocity)
        self.finite = fill_joints(
            self.q, self.velocity, terms.mass_matrix, terms.bias_torque, self.joints)
        if self.finite:
            fill_frame(
                self.velocity, terms.jacobian, terms.position_world, terms.rotation_world,
                terms.sensor_position_world, terms.sensor_rotation_world, self.frames)
        return self.finite
