"""Building what users send on motion/command; the controller's end is in `messages`."""

from __future__ import annotations

from geometry_msgs.msg import Transform, Twist
from multicontact_control.arrays import Vector
from multicontact_control.nodes.messages import MessageError
import numpy as np
from numpy.typing import ArrayLike
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint


def finite_vector(values: ArrayLike, length: int, field: str) -> Vector:
    """
    Return numbers as an array.

    Raises
    ------
    MessageError
        If there are not `length` of them, or one is not finite.

    """
    numbers = np.array(values, dtype=np.float64)
    if numbers.shape != (length,) or not np.isfinite(numbers).all():
        raise MessageError(field, f'{length} finite numbers', numbers.tolist())
    return numbers


def motion_message(
    position_world: ArrayLike, quaternion_xyzw: ArrayLike, twist_world: ArrayLike,
    acceleration_world: ArrayLike,
) -> MultiDOFJointTrajectoryPoint:
    """
    Build a commanded motion of the operational point.

    Parameters
    ----------
    position_world, quaternion_xyzw
        Pose, shapes (3,) [m] and (4,).
    twist_world, acceleration_world
        Linear first, shapes (6,).

    Raises
    ------
    MessageError
        If a number is not finite, or there are not as many as there should be.

    """
    position = finite_vector(position_world, 3, 'translation').tolist()
    quaternion = finite_vector(quaternion_xyzw, 4, 'rotation').tolist()
    pose = Transform()
    pose.translation.x, pose.translation.y, pose.translation.z = position
    pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.rotation.w = quaternion
    return MultiDOFJointTrajectoryPoint(
        transforms=[pose], velocities=[_twist(twist_world, 'velocities')],
        accelerations=[_twist(acceleration_world, 'accelerations')])


def _twist(values: ArrayLike, field: str) -> Twist:
    numbers = finite_vector(values, 6, field).tolist()
    twist = Twist()
    twist.linear.x, twist.linear.y, twist.linear.z = numbers[:3]
    twist.angular.x, twist.angular.y, twist.angular.z = numbers[3:]
    return twist


def quintic(elapsed: float, duration: float) -> tuple[float, float, float]:
    """Return a path from 0 to 1 at rest at both ends, its speed and its acceleration."""
    if elapsed >= duration:
        return 1.0, 0.0, 0.0
    x = max(0.0, elapsed / duration)
    return (x ** 3 * (10.0 + x * (-15.0 + 6.0 * x)),
            30.0 * x ** 2 * (1.0 - x) ** 2 / duration,
            60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / duration ** 2)
