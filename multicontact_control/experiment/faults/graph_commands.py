"""Commands that nobody asked for, and that a controller must not obey, or not at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import time
from typing import Any

from geometry_msgs.msg import Transform, Twist
from multicontact_control.experiment.faults.graph_session import FaultSession, POLL_PERIOD
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

NAN, INF = float('nan'), float('inf')
JUMP = 0.1  # m

Make = Callable[[FaultSession], Any]


def _forces(*efforts: float, names: tuple[str, ...] | None = None) -> Make:
    """Return what makes a command of forces for the first contacts."""
    def make(session: FaultSession) -> JointState:
        known = tuple(session.wanted)[:max(1, len(efforts))]
        return JointState(name=list(known if names is None else names), effort=list(efforts))
    return make


def _motion(change: Callable[[MultiDOFJointTrajectoryPoint], None]) -> Make:
    """Return what makes a command of motion from the present one."""
    def make(session: FaultSession) -> MultiDOFJointTrajectoryPoint:
        transform = Transform()
        if session.watch.pose is not None:
            pose = session.watch.pose.pose
            for axis in 'xyz':
                setattr(transform.translation, axis, getattr(pose.position, axis))
            transform.rotation = pose.orientation
        message = MultiDOFJointTrajectoryPoint(
            transforms=[transform], velocities=[Twist()], accelerations=[Twist()])
        change(message)
        return message
    return make


def _set(path: str, value: float, *, add: bool = False) -> Callable[[Any], None]:
    """Return a change of one number of a message, by the names that lead to it."""
    *way, last = path.split('.')

    def change(message: Any) -> None:
        part = message
        for name in way:
            part = part[int(name)] if name.isdigit() else getattr(part, name)
        setattr(part, last, value + (getattr(part, last) if add else 0.0))
    return change


def _resize(field: str, count: int) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        setattr(message, field, (list(getattr(message, field)) * count)[:count])
    return change


FORCES: Mapping[str, Make] = {
    'nan': _forces(NAN, 5.0), 'infinite': _forces(5.0, INF), 'negative': _forces(-5.0),
    'beyond_ceiling': _forces(1000.0), 'wrong_count': _forces(5.0, 5.0, names=('table',)),
    'unknown_contact': _forces(5.0, names=('nowhere',)), 'empty': _forces(names=())}
MOTIONS: Mapping[str, Make] = {
    'nan': _motion(_set('transforms.0.translation.x', NAN)),
    'nan_twist': _motion(_set('velocities.0.linear.y', NAN)),
    'infinite': _motion(_set('accelerations.0.linear.z', INF)),
    'no_pose': _motion(_resize('transforms', 0)),
    'two_poses': _motion(_resize('transforms', 2)),
    'no_rotation': _motion(_set('transforms.0.rotation.w', 5.0)),
    'outside_box': _motion(_set('transforms.0.translation.z', 50.0)),
    'jump': _motion(_set('transforms.0.translation.x', JUMP, add=True))}


def publish_for(session: FaultSession, topic: str, make: Make, duration: float) -> None:
    """Publish a command again and again beside the rightful user, for a time [s]."""
    operator = session.operator
    publisher = operator.force_command if topic == 'forces' else operator.motion_command
    message = make(session)
    end = time.monotonic() + duration
    while time.monotonic() < end:
        publisher.publish(message)
        session.spin(POLL_PERIOD)
