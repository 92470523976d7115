"""
Messages to arrays and back: pure functions, the only place that knows message layouts.

Reading refuses what is not finite, not named as expected or not of the right length; building
refuses to put a number on a topic that is not finite. All of them raise `MessageError` for that.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
import contextlib
from dataclasses import dataclass
import math
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, Transform, Twist, WrenchStamped
from multicontact_control.arrays import Vector
from multicontact_control.errors import MessageError
from multicontact_control.force.noise import Innovation
from multicontact_control.nodes.loop_statistics import NANOSECONDS
from multicontact_control.sampling import JointReading, MotionReading, WrenchReading
from multicontact_control.wording import counted
import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

LAST_SECOND = 2 ** 31 - 1
UNIT_QUATERNION_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class NamedReading:
    """One number per name at a time, in the order that was asked for."""

    stamp: int
    values: Vector


@dataclass(frozen=True, slots=True)
class InnovationReading:
    """What the observers found at a time, in the order that was asked for."""

    stamp: int
    innovation: Innovation


def stamp_to_ns(stamp: Time) -> int:
    """Return a time stamp in nanoseconds, exactly."""
    nanosec = int(stamp.nanosec)
    if nanosec >= NANOSECONDS:
        raise MessageError('stamp.nanosec', f'below {NANOSECONDS}', nanosec)
    return int(stamp.sec) * NANOSECONDS + nanosec


def ns_to_stamp(nanoseconds: int) -> Time:
    """Return nanoseconds as a time stamp, exactly."""
    sec, nanosec = split_stamp(nanoseconds)
    return Time(sec=sec, nanosec=nanosec)


def split_stamp(nanoseconds: int) -> tuple[int, int]:
    """Return seconds and the nanoseconds beyond them of a time stamp that ROS can hold."""
    sec, nanosec = divmod(nanoseconds, NANOSECONDS)
    if not -LAST_SECOND <= sec <= LAST_SECOND:
        raise MessageError('stamp.sec', f'at most {LAST_SECOND}', sec)
    return sec, nanosec


def all_finite(numbers: Vector) -> bool:
    """Return whether a few numbers are finite; one whose sum overflows is no better."""
    return math.isfinite(sum(numbers.tolist()))


def finite_array(values: ArrayLike, length: int, field: str) -> Vector:
    """Return so many numbers as an array."""
    numbers = np.array(values, dtype=np.float64)
    if numbers.shape != (length,):
        raise MessageError(field, counted(length, 'values'), f'{numbers.size}')
    if not all_finite(numbers):
        raise MessageError(field, 'finite numbers', numbers.tolist())
    return numbers


def places_among(found: Sequence[str], names: Sequence[str]) -> list[int]:
    """
    Return where names are among others.

    Raises
    ------
    MessageError
        If one is not there, or twice.

    """
    others = list(found)
    missing = [name for name in names if others.count(name) != 1]
    if missing:
        raise MessageError('name', f'each of {list(names)} once', others)
    return [others.index(name) for name in names]


def _picked(message: JointState, places: Sequence[int], field: str) -> Vector:
    """Return the numbers at some places of a field that has one per name."""
    values = getattr(message, field)
    if len(values) != len(message.name):
        raise MessageError(field, counted(len(message.name), 'values'), f'{len(values)}')
    return finite_array([values[place] for place in places], len(places), field)


def read_joint_state(message: JointState, names: Sequence[str]) -> JointReading:
    """
    Read positions and velocities, and the effort if it is there: not every robot measures it.

    Parameters
    ----------
    message
        Joint states in any order, of a gripper's joints too.
    names
        The joints that must be there, in the order to return.

    """
    places = places_among(message.name, names)
    effort = None
    with contextlib.suppress(MessageError):
        effort = _picked(message, places, 'effort')
    return JointReading(
        stamp_to_ns(message.header.stamp),
        _picked(message, places, 'position'), _picked(message, places, 'velocity'), effort)


def read_effort(message: JointState, names: Sequence[str]) -> NamedReading:
    """Read one effort per name: joint torques [N m], contact forces [N] or variances [N^2]."""
    places = places_among(message.name, names)
    return NamedReading(
        stamp_to_ns(message.header.stamp), _picked(message, places, 'effort'))


def read_innovation(message: JointState, names: Sequence[str]) -> InnovationReading:
    """Read innovations: effort r [N], velocity C P_1 C^T and position R used [N^2] per contact."""
    places = places_among(message.name, names)
    return InnovationReading(stamp_to_ns(message.header.stamp), Innovation(
        innovation=_picked(message, places, 'effort'),
        prior_variance=_picked(message, places, 'velocity'),
        variance_used=_picked(message, places, 'position')))


def read_force_command(
    message: JointState, names: Sequence[str],
) -> tuple[dict[str, float], dict[str, float]]:
    """
    Read a command for some of the names.

    Returns
    -------
    forces : dict
        Forces and couples [N], which are efforts.
    centres : dict
        Centres of pressure by couple [m], which are positions; a message has one or the other.

    """
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


def read_wrench(message: WrenchStamped, frame: str = '') -> WrenchReading:
    """
    Read a wrench, force first.

    Parameters
    ----------
    message
        The wrench.
    frame
        Frame that it must be of; empty for any. A message that names none is taken at its word.

    """
    found = message.header.frame_id.lstrip('/')
    if frame and found and found != frame:
        raise MessageError('header.frame_id', f"'{frame}' (robot.sensor_frame), or none",
                           f"'{found}'")
    force, torque = message.wrench.force, message.wrench.torque
    values = (force.x, force.y, force.z, torque.x, torque.y, torque.z)
    return WrenchReading(
        stamp_to_ns(message.header.stamp), finite_array(values, 6, 'wrench'))


def read_motion(message: MultiDOFJointTrajectoryPoint) -> MotionReading:
    """Read a commanded motion of one body; twist and acceleration are zero if left out."""
    if len(message.transforms) != 1:
        raise MessageError('transforms', 'one pose', f'{len(message.transforms)}')
    pose = message.transforms[0]
    position = finite_array(
        (pose.translation.x, pose.translation.y, pose.translation.z), 3, 'translation')
    rotation = pose.rotation
    quaternion = finite_array(
        (rotation.x, rotation.y, rotation.z, rotation.w), 4, 'rotation')
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > UNIT_QUATERNION_TOLERANCE:
        raise MessageError('rotation', 'a quaternion of unit length', f'length {norm:.6g}')
    return MotionReading(
        position, quaternion / norm, _read_twist(message.velocities, 'velocities'),
        _read_twist(message.accelerations, 'accelerations'))


def _read_twist(twists: Sequence[Any], field: str) -> Vector:
    if not twists:
        return np.zeros(6)
    if len(twists) != 1:
        raise MessageError(field, 'at most one', f'{len(twists)}')
    linear, angular = twists[0].linear, twists[0].angular
    values = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    return finite_array(values, 6, field)


def joint_state_message(
    stamp: int, names: Sequence[str], *, position: ArrayLike | None = None,
    velocity: ArrayLike | None = None, effort: ArrayLike | None = None, frame_id: str = '',
) -> JointState:
    """Build a named list of numbers."""
    message = JointState()
    message.header.stamp = ns_to_stamp(stamp)
    message.header.frame_id = frame_id
    message.name = list(names)
    count = len(names)
    if position is not None:
        message.position = array('d', finite_array(position, count, 'position').tobytes())
    if velocity is not None:
        message.velocity = array('d', finite_array(velocity, count, 'velocity').tobytes())
    if effort is not None:
        message.effort = array('d', finite_array(effort, count, 'effort').tobytes())
    return message


def wrench_message(stamp: int, wrench: ArrayLike, frame_id: str) -> WrenchStamped:
    """Build a wrench, force first."""
    values = finite_array(wrench, 6, 'wrench').tolist()
    message = WrenchStamped()
    message.header.stamp = ns_to_stamp(stamp)
    message.header.frame_id = frame_id
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = values
    return message


def pose_message(
    stamp: int, position_world: ArrayLike, quaternion_xyzw: ArrayLike, frame_id: str,
) -> PoseStamped:
    """Build a pose."""
    position = finite_array(position_world, 3, 'position').tolist()
    quaternion = finite_array(quaternion_xyzw, 4, 'orientation').tolist()
    message = PoseStamped()
    message.header.stamp = ns_to_stamp(stamp)
    message.header.frame_id = frame_id
    point, rotation = message.pose.position, message.pose.orientation
    point.x, point.y, point.z = position
    rotation.x, rotation.y, rotation.z, rotation.w = quaternion
    return message


def motion_message(
    position_world: ArrayLike, quaternion_xyzw: ArrayLike, twist_world: ArrayLike,
    acceleration_world: ArrayLike,
) -> MultiDOFJointTrajectoryPoint:
    """Build a commanded motion of the operational point; twist and acceleration linear first."""
    pose = Transform()
    pose.translation.x, pose.translation.y, pose.translation.z = finite_array(
        position_world, 3, 'translation').tolist()
    pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.rotation.w = finite_array(
        quaternion_xyzw, 4, 'rotation').tolist()
    return MultiDOFJointTrajectoryPoint(
        transforms=[pose], velocities=[_twist(twist_world, 'velocities')],
        accelerations=[_twist(acceleration_world, 'accelerations')])


def _twist(values: ArrayLike, field: str) -> Twist:
    numbers = finite_array(values, 6, field).tolist()
    twist = Twist()
    twist.linear.x, twist.linear.y, twist.linear.z = numbers[:3]
    twist.angular.x, twist.angular.y, twist.angular.z = numbers[3:]
    return twist
