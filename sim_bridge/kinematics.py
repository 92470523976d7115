"""Where the arm's links are and how they move, compiled: the plant asks at every substep."""

from __future__ import annotations

from multicontact_control.algebra import copy_matrix
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np


@compiled
def forward_kinematics(
    q: Vector, rotations: Matrix, offsets: Matrix, axes: Matrix, origins: Matrix,
    last_rotation: Matrix,
) -> None:
    """
    Place a chain of revolute joints, each about the z axis of its own frame.

    Parameters
    ----------
    q
        Joint angles, shape (n,) [rad].
    rotations, offsets
        Pose of each joint frame in the link before it, shapes (n, 3, 3) and (n, 3) [m].
    axes, origins
        Filled with each joint's axis and origin, world axes, shape (n, 3) [m].
    last_rotation
        Filled with the last link's axes as columns, world axes, shape (3, 3).

    """
    rotation = np.eye(3)
    position = np.zeros(3)
    turned = np.empty((3, 3))
    for joint in range(q.shape[0]):
        for row in range(3):
            for column in range(3):
                position[row] += rotation[row, column] * offsets[joint, column]
        for row in range(3):
            for column in range(3):
                total = 0.0
                for inner in range(3):
                    total += rotation[row, inner] * rotations[joint, inner, column]
                turned[row, column] = total
        cosine, sine = np.cos(q[joint]), np.sin(q[joint])
        for row in range(3):
            x, y = turned[row, 0], turned[row, 1]
            rotation[row, 0] = cosine * x + sine * y
            rotation[row, 1] = cosine * y - sine * x
            rotation[row, 2] = turned[row, 2]
            axes[joint, row] = turned[row, 2]
            origins[joint, row] = position[row]
    copy_matrix(rotation, last_rotation)


@compiled
def point_velocity(
    point: Vector, qd: Vector, axes: Matrix, origins: Matrix, velocity: Vector,
) -> None:
    """
    Fill `velocity` with that of a point fixed in the last link, world axes, shape (3,) [m/s].

    v = sum_i qd_i z_i x (p - o_i), with the axes z and origins o of `forward_kinematics`.
    """
    velocity[0], velocity[1], velocity[2] = 0.0, 0.0, 0.0
    for joint in range(qd.shape[0]):
        x = point[0] - origins[joint, 0]
        y = point[1] - origins[joint, 1]
        z = point[2] - origins[joint, 2]
        velocity[0] += qd[joint] * (axes[joint, 1] * z - axes[joint, 2] * y)
        velocity[1] += qd[joint] * (axes[joint, 2] * x - axes[joint, 0] * z)
        velocity[2] += qd[joint] * (axes[joint, 0] * y - axes[joint, 1] * x)


@compiled
def add_joint_torque(
    point: Vector, force: Vector, sign: float, axes: Matrix, origins: Matrix, torque: Vector,
) -> None:
    """
    Add J^T (sign * force) of a force at a point of the last link, world axes, to `torque`.

    tau_i = z_i . ((p - o_i) x f), shape (n,) [N m].
    """
    for joint in range(torque.shape[0]):
        x = point[0] - origins[joint, 0]
        y = point[1] - origins[joint, 1]
        z = point[2] - origins[joint, 2]
        torque[joint] += sign * (
            axes[joint, 0] * (y * force[2] - z * force[1])
            + axes[joint, 1] * (z * force[0] - x * force[2])
            + axes[joint, 2] * (x * force[1] - y * force[0]))
