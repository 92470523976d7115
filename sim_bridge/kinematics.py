"""Where the arm's links are and how they move, compiled: the plant asks at every substep."""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import (
    add_scaled_vector,
    cross,
    dot,
    vector_between,
)
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.records import Record, record_dtype, Records
import numpy as np
import pinocchio as pin


class Link(Record, Protocol):
    """
    One revolute joint of a chain, and its link.

    Rotation and offset are of the arm; `forward_kinematics` fills in the rest.
    """

    rotation: Annotated[Matrix, 3, 3]  # axes of the joint frame in the link before it
    offset: Annotated[Vector, 3]  # its origin there [m]
    axis: Annotated[Vector, 3]  # z axis of the joint, world axes
    axes: Annotated[Matrix, 3, 3]  # axes of the link as columns, world axes
    origin: Annotated[Vector, 3]  # origin of the joint, world axes [m]


LINK = record_dtype(Link)


def link_records(model: pin.Model) -> Records[Link]:
    """
    Return the links of an arm as records of `LINK`, shape (n,), not yet placed in the world.

    Of pinocchio's model, each of whose joints turns about its z axis.
    """
    links = np.zeros(model.nv, dtype=LINK)
    placements = list(model.jointPlacements)[1:]
    links['rotation'] = [placement.rotation for placement in placements]
    links['offset'] = [placement.translation for placement in placements]
    return links


@compiled
def forward_kinematics(q: Vector, links: Records[Link]) -> None:
    """
    Place a chain of revolute joints in the world, each turned about the z axis of its own frame.

    Parameters
    ----------
    q
        Joint angles, shape (n,) [rad].
    links
        Records of `LINK`, shape (n,); axis, axes and origin are filled in.

    """
    for joint in range(q.shape[0]):
        link = links[joint]
        cosine = np.cos(q[joint])
        sine = np.sin(q[joint])
        for row in range(3):
            if joint == 0:
                place = link.offset[row]
                x = link.rotation[row, 0]
                y = link.rotation[row, 1]
                z = link.rotation[row, 2]
            else:
                before = links[joint - 1]
                place = before.origin[row]
                x = 0.0
                y = 0.0
                z = 0.0
                for inner in range(3):
                    share = before.axes[row, inner]
                    place += share * link.offset[inner]
                    x += share * link.rotation[inner, 0]
                    y += share * link.rotation[inner, 1]
                    z += share * link.rotation[inner, 2]
            link.origin[row] = place
            link.axis[row] = z
            link.axes[row, 0] = cosine * x + sine * y
            link.axes[row, 1] = cosine * y - sine * x
            link.axes[row, 2] = z


@compiled
def locate_point(local: Vector, link: Link, point: Vector) -> None:
    """
    Fill `point` with a point of a link, world axes, shape (3,) [m].

    `local` is the point in the link's own frame, shape (3,) [m].
    """
    for row in range(3):
        point[row] = link.origin[row]
        for column in range(3):
            point[row] += link.axes[row, column] * local[column]


@compiled
def point_velocity(
    point: Vector,
    qd: Vector,
    links: Records[Link],
    last: int,
    velocity: Vector,
) -> None:
    """
    Fill `velocity` with that of a point of the arm, world axes, shape (3,) [m/s].

    v = sum of qd_i z_i x (p - o_i) over the joints i <= last.

    Parameters
    ----------
    point
        p, world axes, shape (3,) [m].
    qd
        Joint speeds, shape (n,) [rad/s].
    links
        Records of `LINK` that `forward_kinematics` has placed, shape (n,).
    last
        Number of the joint that carries the point.
    velocity
        Filled in.

    """
    velocity[:] = 0.0
    for joint in range(last + 1):
        link = links[joint]
        lever = vector_between(link.origin, point)
        add_scaled_vector(velocity, qd[joint], cross(link.axis, lever))


@compiled
def add_joint_torque(
    point: Vector,
    force: Vector,
    sign: float,
    links: Records[Link],
    last: int,
    torque: Vector,
) -> None:
    """
    Add J^T (sign * force), what a force at a point of the arm does to the joints.

    tau_i = z_i . ((p - o_i) x f) for the joints i <= last.

    Parameters
    ----------
    point
        p, world axes, shape (3,) [m].
    force
        World axes, shape (3,) [N].
    sign
        1 for a force on the arm, -1 for one that the arm exerts.
    links
        Records of `LINK` that `forward_kinematics` has placed, shape (n,).
    last
        Number of the joint that carries the point.
    torque
        Added to, shape (n,) [N m].

    """
    for joint in range(last + 1):
        link = links[joint]
        lever = vector_between(link.origin, point)
        torque[joint] += sign * dot(link.axis, cross(lever, force))
