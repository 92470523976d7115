"""
Messages from arrays, and arrays from messages: the only place that builds and reads messages.

Numbers that are not finite, not named as expected or not of the right length are refused by
`MessageError`, on the way in and on the way out.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
import dataclasses
from dataclasses import dataclass
import math
from numbers import Real
import secrets
from typing import Any, TypeGuard

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Pose, Transform, Twist, WrenchStamped
from multicontact_control.arrays import Vector
from multicontact_control.control.tasks import MotionReading
from multicontact_control.errors import format_count, MessageError
from multicontact_control.sampling import NANOSECONDS
import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

UNIT_QUATERNION_TOLERANCE = 1e-3
NUMBERS = 'iuf'  # kinds of numpy: text and truth values are none, though numpy reads them as such
LAST_SECOND = 2**31 - 1  # that a stamp can hold
JOINT_FIELDS = ('position', 'velocity', 'effort')
STATE, ACCEPTED, REFUSED = 'state', 'accepted', 'refused'  # the event of a status
STATUS_TEXTS = (
    'event',
    'command',
    'life_cycle',
    'reaction',
    'causes',
    'contacts',
    'push_test',
    'unwatched',
    'left_out',
)


def stamp_to_ns(stamp: Time) -> int:
    """Return a time stamp in nanoseconds, exactly."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def ns_to_stamp(nanoseconds: int) -> Time:
    """Return nanoseconds as a time stamp, exactly."""
    sec, nanosec = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def finite_array(values: ArrayLike, length: int, field: str) -> Vector:
    """Return so many numbers as an array; they must be finite, and so must be their sum."""
    try:
        numbers = np.array(values)
    except ValueError:  # rows of different lengths
        raise MessageError(
            field, f'{format_count(length, "values")} in one row', repr(values)
        ) from None
    if numbers.dtype.kind not in NUMBERS:
        raise MessageError(
            field, f'{format_count(length, "values")} that are numbers', repr(values)
        )
    numbers = numbers.astype(np.float64)
    if numbers.ndim != 1:
        raise MessageError(
            field,
            f'{format_count(length, "values")} in one row',
            f'an array of shape {numbers.shape}',
        )
    if numbers.size != length:
        raise MessageError(field, format_count(length, 'values'), f'{numbers.size}')
    if not math.isfinite(sum(numbers.tolist())):
        raise MessageError(field, 'finite numbers', numbers.tolist())
    return numbers


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is one finite number; no text, truth value or array is."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        return False
    return math.isfinite(value)


def require_number(field: str, value: object, unit: str) -> None:
    """Refuse what is not one finite number, in a unit."""
    if not is_number(value):
        raise MessageError(field, f'one finite number [{unit}]', repr(value))


def require_positive(field: str, value: object, unit: str) -> None:
    """Refuse what is not one finite number above 0, in a unit."""
    if not is_number(value):
        raise MessageError(field, f'above 0 {unit}', repr(value))
    if value <= 0.0:
        raise MessageError(field, f'above 0 {unit}', f'{value:g} {unit}')


def require_not_negative(field: str, value: object, unit: str) -> None:
    """Refuse what is not one finite number from 0 on, in a unit."""
    require_number(field, value, unit)
    if float(value) < 0.0:  # type: ignore[arg-type]
        raise MessageError(field, f'at least 0 {unit}', f'{value:g} {unit}')


def require_named_numbers(field: str, values: object, unit: str) -> None:
    """Refuse what is not a mapping of names to finite numbers, in a unit."""
    if not isinstance(values, Mapping):
        raise MessageError(
            field, f'numbers by name [{unit}], as {{name: number}}', repr(values)
        )
    for name, value in values.items():
        if not isinstance(name, str):
            raise MessageError(field, 'names that are text', repr(name))
        require_number(f'{field}[{name!r}]', value, unit)


def quaternion_array(values: ArrayLike, field: str) -> Vector:
    """Return a quaternion x, y, z, w of any length above 0 as one of unit length, shape (4,)."""
    quaternion = finite_array(values, 4, field)
    norm = float(np.linalg.norm(quaternion))
    if not 0.0 < norm < math.inf:
        raise MessageError(
            field, 'a quaternion of a length above 0', quaternion.tolist()
        )
    return quaternion / norm


def read_named_vectors(
    message: JointState,
    names: Sequence[str],
    fields: Sequence[str],
    optional: Sequence[str] = (),
    partial: Sequence[str] = (),
) -> tuple[Any, ...]:
    """
    Return the stamp of a message [ns], and a vector per field in the order of `names`.

    Those of the `optional` fields follow, None where numbers are missing or not finite; and those
    of `partial` fields, None where numbers are missing, but with what is not finite in some.
    """
    given, vectors = list(message.name), []
    if any(given.count(name) != 1 for name in names):
        raise MessageError('name', f'each of {list(names)} once', given)
    places = np.array([given.index(name) for name in names], dtype=int)
    for field in (*fields, *optional, *partial):
        values: Vector = np.array(getattr(message, field), dtype=np.float64)
        whole = len(values) == len(given)
        vector = values[places] if whole else values
        usable = whole and (field in partial or math.isfinite(sum(vector.tolist())))
        if not usable and field in fields:
            raise MessageError(
                field, format_count(len(given), 'finite values'), values.tolist()
            )
        vectors.append(vector if usable else None)
    return stamp_to_ns(message.header.stamp), *vectors


def read_variance(message: JointState, names: Sequence[str]) -> tuple[int, Vector]:
    """Return the stamp of a message [ns] and a variance above 0 per name [N^2]."""
    stamp, variance = read_named_vectors(message, names, ('effort',))
    if min(variance.tolist()) <= 0.0:
        raise MessageError('effort', 'variances above 0', variance.tolist())
    return stamp, variance


def read_wrench(message: WrenchStamped, frame: str = '') -> tuple[int, Vector]:
    """Return the stamp of a message [ns] and its wrench, in a frame or none; empty for any."""
    given = message.header.frame_id.lstrip('/')
    if frame and given not in ('', frame):
        raise MessageError(
            'header.frame_id', f"'{frame}' (robot.sensor_frame), or none", f"'{given}'"
        )
    wrench = _list_numbers('xyz', message.wrench.force, message.wrench.torque)
    return stamp_to_ns(message.header.stamp), finite_array(wrench, 6, 'wrench')


def read_force_command(
    message: JointState,
    names: Sequence[str],
) -> tuple[dict[str, float], dict[str, float]]:
    """Read forces and couples by name [N], or else centres of pressure by couple [m]."""
    given = list(message.name)
    if not given or len(set(given)) != len(given) or not set(given) <= set(names):
        raise MessageError('name', f'distinct names among {list(names)}', given)
    if len(message.position) and len(message.effort):
        raise MessageError(
            'position',
            'none beside efforts: centres of pressure are commanded in '
            'a message of their own',
            list(message.position),
        )
    field = 'position' if len(message.position) else 'effort'
    values = finite_array(getattr(message, field), len(given), field)
    numbers = dict(zip(given, values.tolist()))
    return ({}, numbers) if field == 'position' else (numbers, {})


def read_motion(message: MultiDOFJointTrajectoryPoint) -> MotionReading:
    """Read a commanded motion of one body; twist and acceleration are zero if left out."""
    if len(message.transforms) != 1:
        raise MessageError('transforms', 'one pose', f'{len(message.transforms)}')
    pose = message.transforms[0]
    position = finite_array(_list_numbers('xyz', pose.translation), 3, 'translation')
    quaternion = finite_array(_list_numbers('xyzw', pose.rotation), 4, 'rotation')
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > UNIT_QUATERNION_TOLERANCE:
        raise MessageError(
            'rotation', 'a quaternion of unit length', f'length {norm:.6g}'
        )
    return MotionReading(
        position,
        quaternion / norm,
        _read_twist(message.velocities, 'velocities'),
        _read_twist(message.accelerations, 'accelerations'),
    )


def _read_twist(twists: Sequence[Twist], field: str) -> Vector:
    if len(twists) > 1:
        raise MessageError(field, 'at most one', f'{len(twists)}')
    twist = twists[0] if twists else Twist()
    return finite_array(_list_numbers('xyz', twist.linear, twist.angular), 6, field)


def _list_numbers(axes: str, *parts: Any) -> list[float]:
    """Return the numbers of vectors or quaternions, one after the other."""
    return [getattr(part, axis) for part in parts for axis in axes]


def pose_arrays(pose: Pose) -> tuple[Vector, Vector]:
    """Return the position [m] of a pose and its quaternion x, y, z, w."""
    return (
        np.array(_list_numbers('xyz', pose.position)),
        np.array(_list_numbers('xyzw', pose.orientation)),
    )


def _set_numbers(values: ArrayLike, field: str, axes: str, *parts: Any) -> None:
    """Put numbers into vectors or quaternions, one after the other."""
    numbers = iter(finite_array(values, len(axes) * len(parts), field).tolist())
    for part in parts:
        for axis in axes:
            setattr(part, axis, next(numbers))


def joint_state_message(
    stamp: int, names: Sequence[str], **fields: ArrayLike
) -> JointState:
    """Build a named list of numbers, by the `fields` position, velocity and effort."""
    return JointState(
        header=Header(stamp=ns_to_stamp(stamp)),
        name=list(names),
        **{
            field: array('d', finite_array(values, len(names), field).tobytes())
            for field, values in fields.items()
        },
    )


def motion_message(
    position_world: ArrayLike,
    quaternion_xyzw: ArrayLike,
    twist_world: ArrayLike,
    acceleration_world: ArrayLike,
) -> MultiDOFJointTrajectoryPoint:
    """Build a commanded motion of the operational point; twist and acceleration linear first."""
    pose, twist, acceleration = Transform(), Twist(), Twist()
    _set_numbers(position_world, 'translation', 'xyz', pose.translation)
    _set_numbers(quaternion_xyzw, 'rotation', 'xyzw', pose.rotation)
    _set_numbers(twist_world, 'velocities', 'xyz', twist.linear, twist.angular)
    _set_numbers(
        acceleration_world,
        'accelerations',
        'xyz',
        acceleration.linear,
        acceleration.angular,
    )
    return MultiDOFJointTrajectoryPoint(
        transforms=[pose], velocities=[twist], accelerations=[acceleration]
    )


@dataclass(frozen=True, slots=True)
class ControllerStatus:
    """What the controller says of itself on ``~/status``, and of a command."""

    event: str  # `accepted` or `refused` for a command, else `state`
    command: str  # its identifier; empty if it has none
    text: str  # why it is refused; else what the controller does, `ok` for what it is asked for
    life_cycle: str  # `active` or `inactive`
    reaction: str  # `none`, or what it does instead of control
    causes: str
    contacts: str  # the state of each in words
    held: bool  # on command
    refused: int  # commands so far
    readers: (
        int  # of the command's topic that the controller knows, a recorder among them
    )
    push_test: str  # what it asks for; empty for nothing
    forces: Mapping[str, float]  # obeyed by contact and couple [N]; empty in a scenario
    unwatched: str = (
        ''  # whose efforts are of no use, and what is not watched; empty for all
    )
    left_out: str = (
        ''  # what is not obeyed of a command that is accepted; empty for nothing
    )
    # N_i of contacts that are sought or held, along which a motion has no effect, by force and
    # couple, shape (6,).
    placing: Mapping[str, tuple[float, ...]] = dataclasses.field(default_factory=dict)

    @property
    def contact_states(self) -> dict[str, str]:
        """Return the state of each contact by its name."""
        return dict(each.split(' ', 1) for each in self.contacts.split(', ') if each)

    @classmethod
    def from_message(cls, message: DiagnosticStatus) -> ControllerStatus:
        """Return what a message on ``~/status`` says."""
        values = {x.key: x.value for x in message.values}
        forces = [each.rsplit(' ', 1) for each in values['forces'].split(', ') if each]
        placing = [each.split(' ') for each in values['placing'].split(', ') if each]
        return cls(
            text=message.message,
            refused=int(values['refused']),
            readers=int(values['readers']),
            held=values['held'] == str(True),
            forces={name: float(force) for name, force in forces},
            placing={name: tuple(map(float, column)) for name, *column in placing},
            **{name: values[name] for name in STATUS_TEXTS},
        )

    def to_message(self, name: str, level: bytes) -> DiagnosticStatus:
        """Return the message that says so."""
        values = {each: getattr(self, each) for each in STATUS_TEXTS} | {
            'refused': str(self.refused),
            'readers': str(self.readers),
            'held': str(self.held),
            'forces': ', '.join(
                f'{name} {force:.9g}' for name, force in self.forces.items()
            ),
            'placing': ', '.join(
                ' '.join([name, *(f'{x:.9g}' for x in column)])
                for name, column in self.placing.items()
            ),
        }
        return DiagnosticStatus(
            name=name,
            level=level,
            message=self.text,
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )


def new_identifier() -> str:
    """Return an identifier for a command that no other client uses."""
    return str(1 + secrets.randbelow(2**31 - 1))


def set_identifier(command: Any, identifier: str) -> None:
    """Give a command on a topic an identifier; that of a motion is a number of 31 bits."""
    if isinstance(command, JointState):
        command.header.frame_id = identifier
    else:
        command.time_from_start.sec = int(identifier or 0)


def get_identifier(command: Any) -> str:
    """Return the identifier of a command on a topic, empty if it has none."""
    return str(
        command.header.frame_id
        if isinstance(command, JointState)
        else command.time_from_start.sec or ''
    )
