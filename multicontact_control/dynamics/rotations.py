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

    Shepperd's method: of the four ways to take the roots, the one without cancellation.
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
    size = np.sqrt(x * x + y * y + z * z + w * w)
    return x / size, y / size, z / size, w / size


@compiled
def rotation_vector_between(rotation_des: Matrix, rotation: Matrix) -> Triple:
    """
    Return log(R_des R^T), the rotation from an orientation to a desired one, in world axes.

    The result is in [rad], the orientations are of shape (3, 3).
    """
    error = (
        rotate_vector(rotation, rotation_des[0]),
        rotate_vector(rotation, rotation_des[1]),
        rotate_vector(rotation, rotation_des[2]),
    )
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = error
    vector = (0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy))  # its skew part
    cosine = 0.5 * (xx + yy + zz - 1.0)
    sine = vector_length(vector)
    if cosine < -0.99:
        # Near half a turn the skew part vanishes, and no longer names the axis.
        x, y, z, w = quaternion_from_rotation(error)
        sine = vector_length((x, y, z))
        angle = 2.0 * np.arctan2(sine, abs(w))
        if w < 0.0:
            angle = -angle
        return angle * x / sine, angle * y / sine, angle * z / sine
    if sine >= 1e-9:
        factor = np.arctan2(sine, cosine) / sine
        return vector[0] * factor, vector[1] * factor, vector[2] * factor
    return vector


class Pose(NamedTuple):
    """Position and orientation of a frame in the world."""

    position_world: Vector  # origin of the frame, shape (3,) [m]
    rotation_world: Matrix  # its axes as columns, in world axes, shape (3, 3)

    @property
    def quaternion_xyzw(self) -> Vector:
        """Orientation as a unit quaternion, shape (4,), scalar last."""
        # A copy: numba would compile anew for an array of another layout, or not writable.
        return np.array(
            quaternion_from_rotation(np.array(self.rotation_world, order='C'))
        )

    def displacement_to(self, goal: Pose) -> Vector:
        """Return displacement and rotation vector to another pose, world axes, (6,) [m, rad]."""
        turn = Rotation.from_matrix(goal.rotation_world @ self.rotation_world.T)
        return np.concatenate(
            [goal.position_world - self.position_world, turn.as_rotvec()]
        )

    @classmethod
    def from_quaternion(cls, position_world: Vector, quaternion_xyzw: Vector) -> Pose:
        """Build a pose from a position [m] and a quaternion, scalar last, of any length > 0."""
        return cls(
            np.asarray(position_world, dtype=float),
            Rotation.from_quat(quaternion_xyzw).as_matrix(),
        )
