"""Poses, Jacobians and inverse kinematics of an arm, for what is found out before a run."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
import numpy as np
import pinocchio as pin
from sim_bridge.arm import OPERATIONAL_FRAME

LARGEST_ITERATIONS = 500
LARGEST_STEP = 0.2  # rad
DAMPING = 1e-6  # of the inverse of a whole Jacobian [m^2, rad^2]
TURN_DAMPING = 1e-2  # of that of its angular rows, near singular postures too [rad^2]
CENTRING = 0.05  # of the way to the middle of the joints' range per step, where the task lets it
REACHED = 1e-9  # m, rad
ENDLESS = 10.0  # rad, from which on a limit counts as none
PARALLEL = 1e-9  # sine of the angle between directions that are taken for one


def find_posture_at(model: pin.Model, pose: pin.SE3, start: Vector) -> Vector | None:
    """
    Return joint angles that put the operational frame at a pose.

    Damped least squares, within the joints' limits. What the task leaves free goes to the middle
    of the joints' range.

    Parameters
    ----------
    model
        The arm.
    pose
        Of the operational frame, in the world.
    start
        Joint angles from which the search begins, shape (n,) [rad].

    Returns
    -------
    Vector or None
        Joint angles, shape (n,) [rad]; None if `LARGEST_ITERATIONS` do not suffice.

    """
    middle = middle_of_ranges(model, start)
    q = np.array(start, dtype=float)
    for iteration in range(LARGEST_ITERATIONS):
        error = pose_error(model, pose, q)
        if np.abs(error).max() < REACHED:
            return q
        jacobian = frame_jacobian(model, q)
        inverse = damped_inverse(jacobian, DAMPING)
        to_middle = middle - q
        free_part = to_middle - inverse @ (jacobian @ to_middle)
        fading = max(0.0, 1.0 - 2.0 * iteration / LARGEST_ITERATIONS)
        q = _step_within_limits(
            model, q, inverse @ error + CENTRING * fading * free_part
        )
    return None


def find_posture_along(
    model: pin.Model,
    axis: Vector,
    direction_world: Vector,
    start: Vector,
) -> Vector | None:
    """
    Return joint angles that turn an axis of the operational frame along a direction.

    The place of the frame is left free. Damped least squares, within the joints' limits.

    Parameters
    ----------
    model
        The arm.
    axis
        Unit vector in the operational frame, shape (3,).
    direction_world
        Unit vector that the axis is to have, world axes, shape (3,).
    start
        Joint angles from which the search begins, shape (n,) [rad].

    Returns
    -------
    Vector or None
        Joint angles, shape (n,) [rad]; None if `LARGEST_ITERATIONS` do not suffice.

    """
    q = np.array(start, dtype=float)
    for _ in range(LARGEST_ITERATIONS):
        now = frame_pose(model, q).rotation @ axis
        across = np.cross(now, direction_world)
        sine = float(np.linalg.norm(across))
        cosine = float(now @ direction_world)
        if sine < REACHED and cosine > 0.0:
            return q
        error = across * (np.arctan2(sine, cosine) / max(sine, REACHED))
        inverse = damped_inverse(frame_jacobian(model, q)[3:], TURN_DAMPING)
        q = _step_within_limits(model, q, inverse @ error)
    return None


def _step_within_limits(model: pin.Model, q: Vector, change: Vector) -> Vector:
    """Return joint angles after a change, shortened to `LARGEST_STEP`, within the limits [rad]."""
    largest = np.abs(change).max()
    if largest > LARGEST_STEP:
        change = change * (LARGEST_STEP / largest)
    lower, upper = joint_limits(model)
    return np.clip(q + change, lower, upper)


def pose_error(model: pin.Model, pose: pin.SE3, q: Vector) -> Vector:
    """Return the way from the operational frame to a pose, world axes, shape (6,) [m, rad]."""
    now = frame_pose(model, q)
    turn = pin.log3(pose.rotation @ now.rotation.T)
    return np.concatenate([pose.translation - now.translation, turn])


def damped_inverse(jacobian: Matrix, damping: float) -> Matrix:
    """
    Return J^T (J J^T + damping I)^-1, a pseudoinverse that stays finite at singular postures.

    Of a Jacobian of shape (m, n); its shape is (n, m).
    """
    square = jacobian @ jacobian.T
    inverse: Matrix = jacobian.T @ np.linalg.inv(square + damping * np.eye(len(square)))
    return inverse


def joint_limits(model: pin.Model) -> tuple[Vector, Vector]:
    """Return the lower and upper limits of the joints, shape (n,), infinite without one [rad]."""
    lower = np.array(model.lowerPositionLimit)
    upper = np.array(model.upperPositionLimit)
    lower[lower < -ENDLESS] = -np.inf
    upper[upper > ENDLESS] = np.inf
    return lower, upper


def middle_of_ranges(model: pin.Model, otherwise: Vector) -> Vector:
    """Return the middle of each joint's range, or the angle `otherwise` without one [rad]."""
    lower, upper = joint_limits(model)
    limited = np.isfinite(upper - lower)
    middle = np.array(otherwise, dtype=float)
    middle[limited] = 0.5 * (lower[limited] + upper[limited])
    return middle


def frame_pose(model: pin.Model, q: Vector, frame: str = OPERATIONAL_FRAME) -> pin.SE3:
    """Return the pose of a link's frame in the world at joint angles, shape (n,) [rad]."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(frame, pin.FrameType.BODY)].copy()


def frame_jacobian(
    model: pin.Model, q: Vector, frame: str = OPERATIONAL_FRAME
) -> Matrix:
    """Return the Jacobian of a frame, world axes, linear rows first, shape (6, n) [m, rad]."""
    jacobian: Matrix = pin.computeFrameJacobian(
        model,
        model.createData(),
        q,
        model.getFrameId(frame, pin.FrameType.BODY),
        pin.LOCAL_WORLD_ALIGNED,
    )
    return jacobian


def jacobian_condition(model: pin.Model, q: Vector) -> float:
    """
    Return the condition number of the operational point's Jacobian.

    Rows in m and rad are weighed alike, so that it compares postures of one arm; near a singular
    one it grows without bound.
    """
    return float(np.linalg.cond(frame_jacobian(model, q)))


def rotation_between(start: Vector, end: Vector) -> Matrix:
    """
    Return a rotation that turns one unit vector onto another, shape (3, 3).

    One of them must be along z: opposite vectors are turned by half a turn about x. Equal and
    opposite ones get exact matrices, which joints along z keep exact placements by.
    """
    across = np.cross(start, end)
    sine = float(np.linalg.norm(across))
    cosine = float(start @ end)
    if sine > PARALLEL:
        return np.asarray(pin.exp3(across / sine * np.arctan2(sine, cosine)))
    if cosine > 0.0:
        return np.eye(3)
    return np.diag([1.0, -1.0, -1.0])
