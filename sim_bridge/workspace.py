"""The box that an arm reaches with its tool as it is at home, found by sampling."""

from __future__ import annotations

from itertools import product

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.supervision.bounds import SINGULAR_ROOT
import numpy as np
import pinocchio as pin
from sim_bridge.arm import OPERATIONAL_FRAME
from sim_bridge.posture import frame_jacobian, frame_pose, joint_limits

STEP = 0.05  # m, by which a side of the box moves out
SPACING = 0.15  # m between the points that are tried on a side, at most
LARGEST = 1.0  # m from home to a side
STOP_MARGIN = 0.1  # rad that every joint keeps from its stops
REACH_MARGIN = 1.25  # times the distance from a singular posture at which motion ends
STEPS = 12  # of Newton's method from a point to its neighbour
REACHED = 1e-6  # m, rad
DAMPING = 1e-8


def reachable_box(model: pin.Model, home: Vector) -> tuple[Vector, Vector] | None:
    """
    Return the lower and upper corner of the box that the operational point reaches [m].

    From home, joint angles of shape (n,) [rad], each of six sides moves out as long as the points
    on it are reached with the orientation at home, off the joints' stops and singular postures.
    None if that leaves no box, as where home is at a stop.
    """
    pose = frame_pose(model, home)
    corners = np.array([pose.translation, pose.translation])
    known = [(pose.translation, np.array(home, dtype=float))]
    growing = list(product((0, 1), range(3)))
    while growing:
        for side, axis in list(growing):
            wider = corners.copy()
            wider[side, axis] += STEP if side else -STEP
            if abs(wider[side, axis] - pose.translation[axis]) > LARGEST:
                growing.remove((side, axis))
                continue
            reached = _reach_all(
                model, pose.rotation, _points_on(wider, side, axis), known
            )
            if reached is None:
                growing.remove((side, axis))
                continue
            known += reached
            corners = wider
    if (corners[1] - corners[0] < STEP).any():
        return None
    return corners[0], corners[1]


def _points_on(corners: Matrix, side: int, axis: int) -> list[Vector]:
    """Return points of a side of a box, at most `SPACING` apart, shape (3,) each [m]."""
    values = []
    for other in range(3):
        lower, upper = corners[:, other]
        count = 1 + max(1, int(np.ceil((upper - lower) / SPACING)))
        values.append(np.linspace(lower, upper, count))
    values[axis] = corners[side, axis : axis + 1]
    return [np.array(point) for point in product(*values)]


def _reach_all(
    model: pin.Model,
    rotation: Matrix,
    points: list[Vector],
    known: list[tuple[Vector, Vector]],
) -> list[tuple[Vector, Vector]] | None:
    """Return the points with joint angles that reach them, None if one cannot be reached."""
    reached: list[tuple[Vector, Vector]] = []
    for point in points:
        _, start = min(
            known + reached, key=lambda pair: float(np.linalg.norm(pair[0] - point))
        )
        q = _follow(model, pin.SE3(rotation, point), start)
        if q is None or not _is_free(model, q):
            return None
        reached.append((point, q))
    return reached


def _follow(model: pin.Model, pose: pin.SE3, start: Vector) -> Vector | None:
    """Return joint angles at a pose near that of the start, the nearest to it; None if none."""
    q, data = start.copy(), model.createData()
    frame = model.getFrameId(OPERATIONAL_FRAME, pin.FrameType.BODY)
    for _ in range(STEPS):
        jacobian = pin.computeFrameJacobian(
            model, data, q, frame, pin.LOCAL_WORLD_ALIGNED
        )
        now = pin.updateFramePlacement(model, data, frame)
        error = np.concatenate(
            (
                pose.translation - now.translation,
                pin.log3(pose.rotation @ now.rotation.T),
            )
        )
        if np.abs(error).max() < REACHED:
            return q
        q += jacobian.T @ np.linalg.solve(
            jacobian @ jacobian.T + DAMPING * np.eye(6), error
        )
    return None


def _is_free(model: pin.Model, q: Vector) -> bool:
    """Return whether a posture is off the joints' stops and not nearly singular."""
    lower, upper = joint_limits(model)
    if (q < lower + STOP_MARGIN).any() or (q > upper - STOP_MARGIN).any():
        return False
    M = pin.crba(model, model.createData(), q)
    M = np.triu(M) + np.triu(M, 1).T
    J = frame_jacobian(model, q)
    mobility = J @ np.linalg.solve(M, J.T)
    return bool(
        np.sqrt(max(np.linalg.eigvalsh(mobility)[0], 0.0))
        > REACH_MARGIN * SINGULAR_ROOT
    )
