"""Poses, Jacobians and inverse kinematics of an arm, where no run waits for them."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
import numpy as np
import pinocchio as pin
from sim_bridge.arm import OPERATIONAL_FRAME

STEPS = 500
LARGEST_STEP = 0.2  # rad
DAMPING, TURN_DAMPING = 1e-6, 1e-2
CENTRING = 0.05  # of the way to the middle of the joints' range per step, where the task lets it
REACHED = 1e-9  # m, rad
FAR = 10.0  # rad, from which on a limit is none
PARALLEL = 1e-9  # sine of the angle between directions that are taken for one


def find_posture_at(model: pin.Model, pose: pin.SE3, start: Vector) -> Vector | None:
    """
    Return joint angles that put the operational frame at a pose, None if none are found.

    Damped least squares from joint angles `start` on, shape (n,) [rad], within the joints' limits.
    What the task leaves free goes to the middle of the joints' range.
    """
    lower, upper = joint_limits(model)
    middle = middle_of_ranges(model, start)
    q = np.array(start, dtype=float)
    for step in range(STEPS):
        now = frame_pose(model, q)
        error = np.concatenate(
            (
                pose.translation - now.translation,
                pin.log3(pose.rotation @ now.rotation.T),
            )
        )
        if np.abs(error).max() < REACHED:
            return q
        jacobian = frame_jacobian(model, q)
        inverse = jacobian.T @ np.linalg.inv(
            jacobian @ jacobian.T + DAMPING * np.eye(6)
        )
        change = inverse @ error
        fading = CENTRING * max(0.0, 1.0 - 2.0 * step / STEPS)
        change += fading * (middle - q - inverse @ (jacobian @ (middle - q)))
        change *= min(1.0, LARGEST_STEP / max(np.abs(change).max(), 1e-300))
        q = np.clip(q + change, lower, upper)
    return None


def find_posture_along(
    model: pin.Model,
    axis: Vector,
    direction_world: Vector,
    start: Vector,
) -> Vector | None:
    """
    Return joint angles that turn an axis of the operational frame along a direction, or None.

    Both are unit vectors; from joint angles `start` on, shape (n,) [rad], within the joints'
    limits. Where the frame is in the end is left free.
    """
    lower, upper = joint_limits(model)
    q = np.array(start, dtype=float)
    for _ in range(STEPS):
        now = frame_pose(model, q).rotation @ axis
        across = np.cross(now, direction_world)
        sine, cosine = float(np.linalg.norm(across)), float(now @ direction_world)
        if sine < REACHED and cosine > 0.0:
            return q
        error = across * (np.arctan2(sine, cosine) / max(sine, REACHED))
        jacobian = frame_jacobian(model, q)[3:]
        change = jacobian.T @ np.linalg.solve(
            jacobian @ jacobian.T + TURN_DAMPING * np.eye(3), error
        )
        change *= min(1.0, LARGEST_STEP / max(np.abs(change).max(), 1e-300))
        q = np.clip(q + change, lower, upper)
    return None


def joint_limits(model: pin.Model) -> tuple[Vector, Vector]:
    """Return the joints' limits, shape (n,), infinite where there is none [rad]."""
    lower, upper = (
        np.array(model.lowerPositionLimit),
        np.array(model.upperPositionLimit),
    )
    return np.where(lower < -FAR, -np.inf, lower), np.where(upper > FAR, np.inf, upper)


def middle_of_ranges(model: pin.Model, otherwise: Vector) -> Vector:
    """Return the middle of the joints' ranges, and angles `otherwise` without one [rad]."""
    lower, upper = joint_limits(model)
    ends = np.isfinite(lower) & np.isfinite(upper)
    return np.where(
        ends, 0.5 * (np.where(ends, lower, 0.0) + np.where(ends, upper, 0.0)), otherwise
    )


def frame_pose(model: pin.Model, q: Vector, frame: str = OPERATIONAL_FRAME) -> pin.SE3:
    """Return where a frame is in the world at joint angles, shape (n,) [rad]."""
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
    """Return the condition number of the operational point's Jacobian [m, rad]."""
    return float(np.linalg.cond(frame_jacobian(model, q)))


def rotation_between(start: Vector, end: Vector) -> Matrix:
    """Return a rotation that turns one unit vector onto another, one of which is along z."""
    across = np.cross(start, end)
    sine, cosine = float(np.linalg.norm(across)), float(start @ end)
    if sine <= PARALLEL:
        return np.eye(3) if cosine > 0.0 else np.diag([1.0, -1.0, -1.0])
    return np.asarray(pin.exp3(across / sine * np.arctan2(sine, cosine)))
