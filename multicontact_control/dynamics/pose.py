"""A pose in world axes."""

from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.dynamics.kernels import quaternion_of
import numpy as np
from scipy.spatial.transform import Rotation


class Pose(NamedTuple):
    """
    Position and orientation of a frame in the world.

    Attributes
    ----------
    position_world
        Origin of the frame, shape (3,) [m].
    rotation_world
        Columns are the frame's axes in world axes, shape (3, 3).

    """

    position_world: Vector
    rotation_world: Matrix

    @property
    def quaternion_xyzw(self) -> Vector:
        """Orientation as a unit quaternion, shape (4,), scalar last."""
        quaternion = np.empty(4)
        quaternion_of(np.ascontiguousarray(self.rotation_world), quaternion)
        return quaternion

    @classmethod
    def from_quaternion(cls, position_world: Vector, quaternion_xyzw: Vector) -> 'Pose':
        """Build a pose from a position [m] and a quaternion, scalar last, of any length > 0."""
        return cls(np.asarray(position_world, dtype=float),
                   Rotation.from_quat(quaternion_xyzw).as_matrix())


def rotation_error(rotation_des: Matrix, rotation: Matrix) -> Vector:
    """
    Return the rotation that leads from an orientation to a desired one.

    Parameters
    ----------
    rotation_des, rotation
        Desired and present orientation in world axes, shape (3, 3).

    Returns
    -------
    Vector
        Rotation vector log(R_des R^T) in world axes, shape (3,) [rad].

    """
    error = rotation_des @ rotation.T
    sine = 0.5 * np.array([
        error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]])
    cosine = 0.5 * (error[0, 0] + error[1, 1] + error[2, 2] - 1.0)
    length = float(np.sqrt(sine @ sine))
    if cosine < -0.99:  # near half a turn the skew part vanishes and no longer names the axis
        vector: Vector = Rotation.from_matrix(error).as_rotvec()
        return vector
    if length < 1e-9:
        return sine
    return sine * (np.arctan2(length, cosine) / length)
