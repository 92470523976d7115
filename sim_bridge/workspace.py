"""The box that an arm reaches with its tool as it is at home, found by sampling."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.supervision.bounds import SINGULAR_ROOT
import numpy as np
import pinocchio as pin
from sim_bridge.posture import (
    damped_inverse,
    frame_jacobian,
    frame_pose,
    joint_limits,
    pose_error,
)

GROWTH = 0.05  # m, by which a side of the box moves out
SPACING = 0.15  # m between the points that are tried on a side, at most
LARGEST_DISTANCE = 1.0  # m from home to a side
STOP_MARGIN = 0.1  # rad that every joint keeps from its stops
# times the distance from a singular posture at which motion ends.
SINGULAR_MARGIN = 1.25
ITERATIONS = 12  # of Newton's method from a point to its neighbour
REACHED = 1e-6  # m, rad
DAMPING = 1e-8


class ReachedPoint(NamedTuple):
    """A point that the operational point reaches, and how."""

    position: Vector  # in the world, shape (3,) [m]
    posture: Vector  # joint angles, shape (n,) [rad]


def find_reachable_box(model: pin.Model, home: Vector) -> tuple[Vector, Vector] | None:
    """
    Return a box whose sides the operational point reaches with the orientation at home.

    From home each of the six sides moves out by `GROWTH`, as long as the points tried on it are
    reached away from the joints' stops and from singular postures.

    Parameters
    ----------
    model
        The arm with its tool.
    home
        Joint angles to begin from, shape (n,) [rad].

    Returns
    -------
    tuple or None
        Lower and upper corner in the world, shape (3,) each [m]; None if the box has no volume, as
        with a home at a stop.

    """
    pose = frame_pose(model, home)
    corners = np.array([pose.translation, pose.translation])
    reached = [ReachedPoint(pose.translation, np.array(home, dtype=float))]
    growing = list(product((0, 1), range(3)))
    while growing:
        for side, axis in list(growing):
            wider = corners.copy()
            wider[side, axis] += GROWTH * (2 * side - 1)
            distance = abs(wider[side, axis] - pose.translation[axis])
            new = None
            if distance <= LARGEST_DISTANCE:
                points = _points_on_side(wider, side, axis)
                new = _reach_points(model, pose.rotation, points, reached)
            if new is None:
                growing.remove((side, axis))
            else:
                reached += new
                corners = wider
    if (corners[1] - corners[0] < GROWTH).any():
        return None
    return corners[0], corners[1]


def _points_on_side(corners: Matrix, side: int, axis: int) -> list[Vector]:
    """Return points of a side of a box, at most `SPACING` apart, shape (3,) each [m]."""
    coordinates = []
    for other in range(3):
        lower, upper = corners[:, other]
        count = 1 + max(1, int(np.ceil((upper - lower) / SPACING)))
        coordinates.append(np.linspace(lower, upper, count))
    coordinates[axis] = corners[side, axis : axis + 1]
    return [np.array(point) for point in product(*coordinates)]


def _reach_points(
    model: pin.Model,
    rotation: Matrix,
    points: list[Vector],
    known: list[ReachedPoint],
) -> list[ReachedPoint] | None:
    """Return how points are reached, each from its nearest known one; None if one is not."""
    new: list[ReachedPoint] = []
    for point in points:
        candidates = known + new
        distances = [np.linalg.norm(each.position - point) for each in candidates]
        start = candidates[int(np.argmin(distances))].posture
        q = _follow_pose(model, pin.SE3(rotation, point), start)
        if q is None or not _is_free(model, q):
            return None
        new.append(ReachedPoint(point, q))
    return new


def _follow_pose(model: pin.Model, pose: pin.SE3, start: Vector) -> Vector | None:
    """Return the joint angles at a pose that are nearest to those of a pose beside it, or None."""
    q = start.copy()
    for _ in range(ITERATIONS):
        error = pose_error(model, pose, q)
        if np.abs(error).max() < REACHED:
            return q
        q += damped_inverse(frame_jacobian(model, q), DAMPING) @ error
    return None


def _is_free(model: pin.Model, q: Vector) -> bool:
    """Return whether a posture is off the joints' stops and not nearly singular."""
    lower, upper = joint_limits(model)
    if (q < lower + STOP_MARGIN).any() or (q > upper - STOP_MARGIN).any():
        return False
    M = pin.crba(model, model.createData(), q)
    J = frame_jacobian(model, q)
    smallest_mobility = np.linalg.eigvalsh(J @ np.linalg.solve(M, J.T))[0]
    return bool(np.sqrt(max(smallest_mobility, 0.0)) > SINGULAR_MARGIN * SINGULAR_ROOT)
