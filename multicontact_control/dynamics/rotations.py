"""Poses, and rotations as quaternions and rotation vectors."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.algebra import dot
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np
from scipy.spatial.transform import Rotation


@compiled
def quaternion_of(rotation: Matrix, quaternion: Vector) -> None:
    """
    Fill in the unit quaternion, scalar last, shape (4,), of a rotation, shape (3, 3).

    Shepperd's method: of the four ways to take the roots, the one without cancellation.
    """
    trace = rotation[0, 0] + rotation[1, 1] + rotation[2, 2]
    largest, greatest = 3, trace
    for i in range(3):
        if rotation[i, i] > greatest:
            largest, greatest = i, rotation[i, i]
    if largest == 3:
        quaternion[0] = rotation[2, 1] - rotation[1, 2]
        quaternion[1] = rotation[0, 2] - rotation[2, 0]
        quaternion[2] = rotation[1, 0] - rotation[0, 1]
        quaternion[3] = 1.0 + trace
    else:
        i = largest
        j = (i + 1) % 3
        k = (i + 2) % 3
        quaternion[i] = 1.0 - trace + 2.0 * rotation[i, i]
        quaternion[j] = rotation[j, i] + rotation[i, j]
        quaternion[k] = rotation[k, i] + rotation[i, k]
        quaternion[3] = rotation[k, j] - rotation[j, k]
    quaternion /= np.sqrt(dot(quaternion, quaternion))


@compiled
def rotation_vector(rotation_des: Matrix, rotation: Matrix, vector: Vector) -> None:
    """
    Fill in log(R_des R^T), the rotation from an orientation to a desired one, in world axes.

    The result is of shape (3,) [rad], the orientations are of shape (3, 3).
    """
    error = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            error[i, j] = (rotation_des[i, 0] * rotation[j, 0]
                           + rotation_des[i, 1] * rotation[j, 1]
                           + rotation_des[i, 2] * rotation[j, 2])
    vector[0] = 0.5 * (error[2, 1] - error[1, 2])
    vector[1] = 0.5 * (error[0, 2] - error[2, 0])
    vector[2] = 0.5 * (error[1, 0] - error[0, 1])
    cosine = 0.5 * (error[0, 0] + error[1, 1] + error[2, 2] - 1.0)
    sine = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if cosine < -0.99:  # near half a turn the skew part vanishes and no longer names the axis
        quaternion = np.empty(4)
        quaternion_of(error, quaternion)
        sine = np.sqrt(quaternion[0] ** 2 + quaternion[1] ** 2 + quaternion[2] ** 2)
        angle = 2.0 * np.arctan2(sine, abs(quaternion[3]))
        sign = 1.0 if quaternion[3] >= 0.0 else -1.0
        vector[:] = sign * angle * quaternion[:3] / sine
    elif sine >= 1e-9:
        vector *= np.arctan2(sine, cosine) / sine


class Pose(NamedTuple):
    """Position and orientation of a frame in the world."""

    position_world: Vector  # origin of the frame, shape (3,) [m]
    rotation_world: Matrix  # its axes as columns, in world axes, shape (3, 3)

    @property
    def quaternion_xyzw(self) -> Vector:
        """Orientation as a unit quaternion, shape (4,), scalar last."""
        quaternion = np.empty(4)
        # A copy: numba would compile anew for an array of another layout, or not writable.
        quaternion_of(np.array(self.rotation_world, order='C'), quaternion)
        return quaternion

    def way_to(self, goal: Pose) -> Vector:
        """Return displacement and rotation vector to another pose, world axes, (6,) [m, rad]."""
        turn = Rotation.from_matrix(goal.rotation_world @ self.rotation_world.T)
        return np.concatenate([goal.position_world - self.position_world, turn.as_rotvec()])

    @classmethod
    def from_quaternion(cls, position_world: Vector, quaternion_xyzw: Vector) -> Pose:
        """Build a pose from a position [m] and a quaternion, scalar last, of any length > 0."""
        return cls(np.asarray(position_world, dtype=float),
                   Rotation.from_quat(quaternion_xyzw).as_matrix())
