"""What supervision needs to know of the arm at every tick, and no more."""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import all_finite, Matrix, Vector
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel
import numpy as np


@dataclass(frozen=True, slots=True)
class ArmView:
    """
    The arm at one instant.

    Attributes
    ----------
    q, velocity
        Joint positions [rad] and velocities [rad/s], shape (n,).
    inertia
        Diagonal of M, shape (n,) [kg m^2].
    bias_torque
        C v + g, shape (n,) [N m].
    pose, twist_world
        Of the operational frame.
    sensor_rotation
        Axes of the wrist sensor in world axes, shape (3, 3).

    """

    q: Vector
    velocity: Vector
    inertia: Vector
    bias_torque: Vector
    pose: Pose
    twist_world: Vector
    sensor_rotation: Matrix


def view_arm(robot: RobotModel, q: Vector, velocity: Vector) -> ArmView | None:
    """Return the arm at a joint state; None if its model gives no finite numbers there."""
    terms = robot.compute(q, velocity)
    bias_torque = terms.bias_torque.copy()
    if not all_finite(bias_torque):
        return None
    return ArmView(
        q=q, velocity=velocity, inertia=np.diagonal(terms.mass_matrix).copy(),
        bias_torque=bias_torque,
        pose=Pose(terms.position_world.copy(), terms.rotation_world.copy()),
        twist_world=terms.jacobian @ velocity, sensor_rotation=terms.sensor_rotation_world.copy())
