"""Poses, and rotations as quaternions and rotation vectors."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.algebra import rotate_vector, Triple, vector_length
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np
from scipy.spatial.transform import Rotation

Rows = tuple[Triple, Triple, Triple]


@compiled
def quaternion_from_rotation(
    rotation: Matrix | Rows,
) -> tuple[float, float, float, float]:
    """
    Return the unit quaternion, scalar last, of a rotation, shape (3, 3).

    Shepperd's method: the greatest of the trace and the diagonal names the largest component of
    the quaternion, from whose root the other three follow without cancellation.
    """
    xx, xy, xz = rotation[0][0], rotation[0][1], rotation[0][2]
    yx, yy, yz = rotation[1][0], rotation[1][1], rotation[1][2]
    zx, zy, zz = rotation[2][0], rotation[2][1], rotation[2][2]
    trace = xx + yy + zz
    greatest = max(trace, xx, yy, zz)
    if greatest == trace:
        x = zy - yz
        y = xz - zx
        z = yx - xy
        w = 1.0 + trace
    elif greatest == xx:
        x = 1.0 - trace + 2.0 * xx
        y = yx + xy
        z = zx + xz
        w = zy - yz
    elif greatest == yy:
        x = xy + yx
        y = 1.0 - trace + 2.0 * yy
        z = zy + yz
        w = xz - zx
    else:
        x = xz + zx
        y = yz + zy
        z = 1.0 - trace + 2.0 * zz
        w = yx - xy
    norm = np.sqrt(x * x + y * y + z * z + w * w)
    return x / norm, y / norm, z / norm, w / norm


@compiled
def rotation_vector_between(rotation_des: Matrix, rotation: Matrix) -> Triple:
    """
    Return log(R_des R^T), the rotation from an orientation to a desired one.

    The skew part of R_des R^T is the axis times the sine of the angle. Near half a turn it
    vanishes and no longer names the axis, which then comes from the quaternion.

    Parameters
    ----------
    rotation_des, rotation
        R_des and R, shape (3, 3), each with the axes of a frame as columns in world axes.

    Returns
    -------
    Triple
        Rotation vector in world axes [rad], of a length up to pi.

    """
    error = (
        rotate_vector(rotation, rotation_des[0]),
        rotate_vector(rotation, rotation_des[1]),
        rotate_vector(rotation, rotation_des[2]),
    )
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = error
    cosine = 0.5 * (xx + yy + zz - 1.0)
    if cosine < -0.99:
        x, y, z, w = quaternion_from_rotation(error)
        sine = vector_length((x, y, z))
        angle = 2.0 * np.arctan2(sine, abs(w))
        if w < 0.0:
            angle = -angle
        return angle * x / sine, angle * y / sine, angle * z / sine
    x = 0.5 * (zy - yz)
    y = 0.5 * (xz - zx)
    z = 0.5 * (yx - xy)
    sine = vector_length((x, y, z))
    if sine < 1e-9:
        return x, y, z
    factor = np.arctan2(sine, cosine) / sine
    return x * factor, y * factor, z * factor


class Pose(NamedTuple):
    """
    Position and orientation of a frame in the world.

    Attributes
    ----------
    position_world
        Origin of the frame in world axes, shape (3,) [m].
    rotation_world
        Axes of the frame as columns, in world axes, shape (3, 3).

    """

    position_world: Vector
    rotation_world: Matrix

    @property
    def quaternion_xyzw(self) -> Vector:
        """Orientation as a unit quaternion, shape (4,), scalar last."""
        # A copy: numba would compile anew for an array of another layout, or not writable.
        rotation = np.array(self.rotation_world, order='C')
        return np.array(quaternion_from_rotation(rotation))

    def displacement_to(self, goal: Pose) -> Vector:
        """Return the displacement and the rotation vector to another pose, (6,) [m, rad]."""
        displacement = goal.position_world - self.position_world
        turn = Rotation.from_matrix(goal.rotation_world @ self.rotation_world.T)
        return np.concatenate([displacement, turn.as_rotvec()])

    def moved_by(self, displacement: Vector) -> Pose:
        """Return the pose after a displacement and a rotation vector, (6,) [m, rad]."""
        position = self.position_world + displacement[:3]
        if not displacement[3:].any():
            return Pose(position, self.rotation_world)
        turn = Rotation.from_rotvec(displacement[3:]).as_matrix()
        return Pose(position, turn @ self.rotation_world)

    @classmethod
    def from_quaternion(cls, position_world: Vector, quaternion_xyzw: Vector) -> Pose:
        """
        Build a pose from a position and a quaternion, as messages have them.

        Parameters
        ----------
        position_world
            Origin of the frame in world axes, shape (3,) [m].
        quaternion_xyzw
            Orientation of the frame, shape (4,), scalar last, of any length above 0.

        """
        position = np.asarray(position_world, dtype=float)
        return cls(position, Rotation.from_quat(quaternion_xyzw).as_matrix())
