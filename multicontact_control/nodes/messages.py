"""
Messages from arrays, and commands from messages: the only place that builds message objects.

Numbers that are not finite, not named as expected or not of the right length are refused by
`MessageError`, on the way in and on the way out. Messages at the control rate: `streams`.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
import math
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, Transform, Twist
from multicontact_control.arrays import Vector
from multicontact_control.control.tasks import MotionReading
from multicontact_control.errors import counted, MessageError
from multicontact_control.sampling import NANOSECONDS
import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

LAST_SECOND = 2 ** 31 - 1
UNIT_QUATERNION_TOLERANCE = 1e-3


def stamp_to_ns(stamp: Time) -> int:
    """Return a time stamp in nanoseconds, exactly."""
    nanosec = int(stamp.nanosec)
    if nanosec >= NANOSECONDS:
        raise MessageError('stamp.nanosec', f'below {NANOSECONDS}', nanosec)
    return int(stamp.sec) * NANOSECONDS + nanosec


def ns_to_stamp(nanoseconds: int) -> Time:
    """Return nanoseconds as a time stamp, exactly; MessageError if ROS cannot hold it."""
    sec, nanosec = divmod(nanoseconds, NANOSECONDS)
    if abs(sec) > LAST_SECOND:
        raise MessageError('stamp.sec', f'at most {LAST_SECOND}', sec)
    return Time(sec=sec, nanosec=nanosec)


def finite_array(values: ArrayLike, length: int, field: str) -> Vector:
    """Return so many numbers as an array; they must be finite, and so must be their sum."""
    numbers = np.array(values, dtype=np.float64)
    if numbers.shape != (length,):
        raise MessageError(field, counted(length, 'values'), f'{numbers.size}')
    if not math.isfinite(sum(numbers.tolist())):
        raise MessageError(field, 'finite numbers', numbers.tolist())
    return numbers


def read_force_command(
    message: JointState, names: Sequence[str],
) -> tuple[dict[str, float], dict[str, float]]:
    """Read forces and couples by name [N], or else centres of pressure by couple [m]."""
    found = list(message.name)
    if not found or len(set(found)) != len(found) or not set(found) <= set(names):
        raise MessageError('name', f'distinct names among {list(names)}', found)
    if len(message.position) and len(message.effort):
        raise MessageError('position', 'none beside efforts: centres of pressure are commanded in '
                           'a message of their own', list(message.position))
    field = 'position' if len(message.position) else 'effort'
    values = finite_array(getattr(message, field), len(found), field)
    numbers = {name: float(value) for name, value in zip(found, values)}
    return ({}, numbers) if field == 'position' else (numbers, {})


def read_motion(message: MultiDOFJointTrajectoryPoint) -> MotionReading:
    """Read a commanded motion of one body; twist and acceleration are zero if left out."""
    if len(message.transforms) != 1:
        raise MessageError('transforms', 'one pose', f'{len(message.transforms)}')
    pose = message.transforms[0]
    position = finite_array(_numbers('xyz', pose.translation), 3, 'translation')
    quaternion = finite_array(_numbers('xyzw', pose.rotation), 4, 'rotation')
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > UNIT_QUATERNION_TOLERANCE:
        raise MessageError('rotation', 'a quaternion of unit length', f'length {norm:.6g}')
    return MotionReading(
        position, quaternion / norm, _read_twist(message.velocities, 'velocities'),
        _read_twist(message.accelerations, 'accelerations'))


def _read_twist(twists: Sequence[Twist], field: str) -> Vector:
    if len(twists) > 1:
        raise MessageError(field, 'at most one', f'{len(twists)}')
    twist = twists[0] if twists else Twist()
    return finite_array(_numbers('xyz', twist.linear, twist.angular), 6, field)


def _numbers(axes: str, *parts: Any) -> list[float]:
    """Return the numbers of vectors or quaternions, one after the other."""
    return [getattr(part, axis) for part in parts for axis in axes]


def pose_arrays(pose: Pose) -> tuple[Vector, Vector]:
    """Return the position [m] of a pose and its quaternion x, y, z, w."""
    return (np.array(_numbers('xyz', pose.position)),
            np.array(_numbers('xyzw', pose.orientation)))


def _fill(values: ArrayLike, field: str, axes: str, *parts: Any) -> None:
    """Put numbers into vectors or quaternions, one after the other."""
    numbers = iter(finite_array(values, len(axes) * len(parts), field).tolist())
    for part in parts:
        for axis in axes:
            setattr(part, axis, next(numbers))


def joint_state_message(
    stamp: int, names: Sequence[str], *, position: ArrayLike | None = None,
    velocity: ArrayLike | None = None, effort: ArrayLike | None = None,
) -> JointState:
    """Build a named list of numbers."""
    message = JointState(header=Header(stamp=ns_to_stamp(stamp)), name=list(names))
    for field, values in (('position', position), ('velocity', velocity), ('effort', effort)):
        if values is not None:
            numbers = finite_array(values, len(names), field)
            setattr(message, field, array('d', numbers.tobytes()))
    return message


def motion_message(
    position_world: ArrayLike, quaternion_xyzw: ArrayLike, twist_world: ArrayLike,
    acceleration_world: ArrayLike,
) -> MultiDOFJointTrajectoryPoint:
    """Build a commanded motion of the operational point; twist and acceleration linear first."""
    pose, twist, acceleration = Transform(), Twist(), Twist()
    _fill(position_world, 'translation', 'xyz', pose.translation)
    _fill(quaternion_xyzw, 'rotation', 'xyzw', pose.rotation)
    _fill(twist_world, 'velocities', 'xyz', twist.linear, twist.angular)
    _fill(acceleration_world, 'accelerations', 'xyz', acceleration.linear, acceleration.angular)
    return MultiDOFJointTrajectoryPoint(
        transforms=[pose], velocities=[twist], accelerations=[acceleration])
