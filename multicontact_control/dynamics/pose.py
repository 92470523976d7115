"""A pose in world axes."""

from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.dynamics.rotations import quaternion_of
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
        # A copy: numba would compile anew for an array of another layout, or not writable.
        quaternion_of(np.array(self.rotation_world, order='C'), quaternion)
        return quaternion

    @classmethod
    def from_quaternion(cls, position_world: Vector, quaternion_xyzw: Vector) -> 'Pose':
        """Build a pose from a position [m] and a quaternion, scalar last, of any length > 0."""
        return cls(np.asarray(position_world, dtype=float),
                   Rotation.from_quat(quaternion_xyzw).as_matrix())
