"""Joint angles for a pose of the operational point, by inverse kinematics."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
import numpy as np
import pinocchio as pin
from sim_bridge.arm import OPERATIONAL_FRAME

STEPS = 500
LARGEST_STEP = 0.2  # rad
DAMPING = 1e-6
CENTRING = 0.05  # of the way to the middle of the joints' range per step, where the task lets it
REACHED = 1e-9  # m, rad
FAR = 10.0  # rad, from which on a limit is none


def reach(model: pin.Model, pose: pin.SE3, start: Vector) -> Vector | None:
    """
    Return joint angles that put the operational frame there, None if none are found.

    Damped least squares from a posture on, within the joints' limits. What the task leaves free
    goes to the middle of the joints' range.

    Parameters
    ----------
    model
        The arm.
    pose
        Wanted, in the world.
    start
        Shape (n,) [rad].

    """
    data, frame = model.createData(), model.getFrameId(OPERATIONAL_FRAME)
    lower, upper = limits_of(model)
    ends = np.isfinite(lower) & np.isfinite(upper)
    middle = np.where(ends, 0.5 * (np.where(ends, lower, 0.0) + np.where(ends, upper, 0.0)), start)
    q = np.array(start, dtype=float)
    for step in range(STEPS):
        error, jacobian = _error(model, data, frame, pose, q)
        if np.abs(error).max() < REACHED:
            return q
        inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + DAMPING * np.eye(6))
        change = inverse @ error
        fading = CENTRING * max(0.0, 1.0 - 2.0 * step / STEPS)
        change += fading * (middle - q - inverse @ (jacobian @ (middle - q)))
        change *= min(1.0, LARGEST_STEP / max(np.abs(change).max(), 1e-300))
        q = np.clip(q + change, lower, upper)
    return None


def limits_of(model: pin.Model) -> tuple[Vector, Vector]:
    """Return the joints' limits, shape (n,), infinite where there is none [rad]."""
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    return np.where(lower < -FAR, -np.inf, lower), np.where(upper > FAR, np.inf, upper)


def _error(
    model: pin.Model, data: pin.Data, frame: int, pose: pin.SE3, q: Vector,
) -> tuple[Vector, Vector]:
    """Return how far the frame is off, and its Jacobian, both in world axes."""
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    now = data.oMf[frame]
    turn = pin.log3(pose.rotation @ now.rotation.T)
    jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    return np.concatenate((pose.translation - now.translation, turn)), jacobian


def frame_pose(model: pin.Model, q: Vector, frame: str = OPERATIONAL_FRAME) -> pin.SE3:
    """Return where a frame is in the world at joint angles, shape (n,) [rad]."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(frame)].copy()


def condition(model: pin.Model, q: Vector) -> float:
    """Return the condition number of the operational point's Jacobian [m, rad]."""
    return float(np.linalg.cond(frame_jacobian(model, q)))


def frame_jacobian(model: pin.Model, q: Vector, frame: str = OPERATIONAL_FRAME) -> Matrix:
    """Return the Jacobian of a frame, world axes, linear rows first, shape (6, n) [m, rad]."""
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    jacobian: Matrix = pin.getFrameJacobian(
        model, data, model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED)
    return jacobian
