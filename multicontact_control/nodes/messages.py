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

from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Pose, Transform, Twist, WrenchStamped
from multicontact_control.arrays import Vector
from multicontact_control.control.tasks import MotionReading
from multicontact_control.control.trajectory_checks import TimedPoses
from multicontact_control.errors import format_count, MessageError
from multicontact_control.sampling import NANOSECONDS
import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

UNIT_QUATERNION_TOLERANCE = 1e-3
NUMBERS = 'iuf'  # kinds of numpy: text and truth values are none, though numpy reads them as such
SECONDS = range(-(2**31), 2**31)  # of a stamp
# Of an input's stamp: a day less at either end, since answers carry later stamps while time is
# counted on without inputs.
INPUT_SECONDS = range(-(2**31) + 86_400, 2**31 - 86_400)
JOINT_FIELDS = ('position', 'velocity', 'effort')  # of a JointState, in its order
# Commands that have their identifier in the header.
WITH_HEADER = JointState, MultiDOFJointTrajectory
# Events of a status: the controller's state alone, or the answer to a command.
STATE = 'state'
ACCEPTED = 'accepted'
REFUSED = 'refused'


def stamp_to_ns(stamp: Time | Duration) -> int:
    """Return a time stamp in whole nanoseconds: exact, unlike seconds as a float."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def ns_to_stamp(nanoseconds: int) -> Time:
    """Return whole nanoseconds as a time stamp: the inverse of `stamp_to_ns`."""
    seconds, remainder = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=remainder)


def read_stamp(header: Header) -> int:
    """Return the stamp of an input [ns]; MessageError if its second is outside `INPUT_SECONDS`."""
    if header.stamp.sec not in INPUT_SECONDS:
        first, last = INPUT_SECONDS[0], INPUT_SECONDS[-1]
        raise MessageError('header.stamp.sec', f'{first} to {last}', header.stamp.sec)
    return stamp_to_ns(header.stamp)


def finite_array(values: ArrayLike, length: int, field: str) -> Vector:
    """
    Return numbers as an array of floats.

    Parameters
    ----------
    values, length
        One row of numbers, of which there have to be so many. Their sum has to be finite, too.
    field
        Name of the values in an error.

    Returns
    -------
    Vector
        A new array of shape (length,).

    Raises
    ------
    MessageError
        If the values are no numbers, too few or too many, not in one row or not finite.

    """
    in_one_row = f'{format_count(length, "values")} in one row'
    try:
        numbers = np.array(values)
    except ValueError:  # rows of different lengths
        raise MessageError(field, in_one_row, repr(values)) from None
    if numbers.dtype.kind not in NUMBERS:
        expected = f'{format_count(length, "values")} that are numbers'
        raise MessageError(field, expected, repr(values))
    if numbers.ndim != 1:
        raise MessageError(field, in_one_row, f'an array of shape {numbers.shape}')
    if numbers.size != length:
        raise MessageError(field, format_count(length, 'values'), f'{numbers.size}')
    numbers = numbers.astype(np.float64)
    if not math.isfinite(sum(numbers.tolist())):
        raise MessageError(field, 'finite numbers', numbers.tolist())
    return numbers


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is one finite number; text, truth values and arrays are not."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        return False
    return math.isfinite(value)


def require_number(field: str, value: object, unit: str) -> float:
    """Return a value that is one finite number in a unit; MessageError of the field if not."""
    if not is_number(value):
        raise MessageError(field, f'one finite number [{unit}]', repr(value))
    return float(value)


def require_positive(field: str, value: object, unit: str) -> None:
    """Refuse a value by MessageError of the field, unless it is one finite number above 0."""
    if not is_number(value):
        raise MessageError(field, f'above 0 {unit}', repr(value))
    if value <= 0.0:
        raise MessageError(field, f'above 0 {unit}', f'{value:g} {unit}')


def require_not_negative(field: str, value: object, unit: str) -> None:
    """Refuse a value by MessageError of the field, unless it is one finite number from 0 on."""
    number = require_number(field, value, unit)
    if number < 0.0:
        raise MessageError(field, f'at least 0 {unit}', f'{number:g} {unit}')


def require_named_numbers(field: str, values: object, unit: str) -> None:
    """Refuse values by MessageError, unless they map names to finite numbers in a unit."""
    if not isinstance(values, Mapping):
        raise MessageError(
            field, f'numbers by name [{unit}], as {{name: number}}', repr(values)
        )
    for name, value in values.items():
        if not isinstance(name, str):
            raise MessageError(field, 'names that are text', repr(name))
        require_number(f'{field}[{name!r}]', value, unit)


def quaternion_array(values: ArrayLike, field: str) -> Vector:
    """
    Return a quaternion x, y, z, w, of any length above 0, as one of unit length, shape (4,).

    MessageError of the field if it has no direction, or is no quaternion.
    """
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
    unchecked: Sequence[str] = (),
) -> tuple[Any, ...]:
    """
    Return the stamp of a message and vectors of its fields, in the order of some names.

    Parameters
    ----------
    message
        Numbers by name, in any order, with further names or none.
    names
        Names to read, each of which has to be there once.
    fields
        Fields that have to be there, all numbers finite.
    optional
        Fields of which the vector is None if numbers are missing or not finite.
    unchecked
        Fields of which the vector is None if numbers are missing; some may be not finite.

    Returns
    -------
    tuple
        The stamp [ns], then a vector, shape (names,), or None per field: `fields`, `optional`,
        `unchecked`.

    Raises
    ------
    MessageError
        If a name is missing or there twice, one of `fields` is unusable, or so is the stamp.

    """
    given = list(message.name)
    if any(given.count(name) != 1 for name in names):
        raise MessageError('name', f'each of {list(names)} once', given)
    places = np.array([given.index(name) for name in names], dtype=int)
    vectors: list[Vector | None] = []
    for field in (*fields, *optional, *unchecked):
        values: Vector = np.array(getattr(message, field), dtype=np.float64)
        vector = None
        if len(values) == len(given):
            vector = values[places]
            if field not in unchecked and not math.isfinite(sum(vector.tolist())):
                vector = None
        if vector is None and field in fields:
            raise MessageError(
                field, format_count(len(given), 'finite values'), values.tolist()
            )
        vectors.append(vector)
    return read_stamp(message.header), *vectors


def read_variance(message: JointState, names: Sequence[str]) -> tuple[int, Vector]:
    """
    Return the stamp of a message [ns] and R, a variance above 0 per name, shape (names,) [N^2].

    MessageError if a name or number is missing, a number is not above 0, or the stamp is unusable.
    """
    stamp, variance = read_named_vectors(message, names, ('effort',))
    if min(variance.tolist()) <= 0.0:
        raise MessageError('effort', 'variances above 0', variance.tolist())
    return stamp, variance


def read_wrench(message: WrenchStamped, frame: str = '') -> tuple[int, Vector]:
    """
    Return the stamp of a message [ns] and its wrench, shape (6,) [N, N m].

    A message has to name its frame as `frame`, or none at all; an empty `frame` takes any.
    MessageError if it names another one, or its stamp or a number is unusable.
    """
    given = message.header.frame_id.lstrip('/')
    if frame and given not in ('', frame):
        raise MessageError(
            'header.frame_id', f"'{frame}' (robot.sensor_frame), or none", f"'{given}'"
        )
    wrench = _list_numbers('xyz', message.wrench.force, message.wrench.torque)
    return read_stamp(message.header), finite_array(wrench, 6, 'wrench')


def read_force_command(
    message: JointState, names: Sequence[str]
) -> tuple[dict[str, float], dict[str, float]]:
    """
    Return the commanded forces and couples by name [N], and centres of pressure by couple [m].

    One of both is empty: a message has either efforts, which are forces, or positions, which are
    centres. MessageError if it has both, a name not among `names`, or one twice.
    """
    given = list(message.name)
    if not given or len(set(given)) != len(given) or not set(given) <= set(names):
        raise MessageError('name', f'distinct names among {list(names)}', given)
    if not len(message.position):
        forces = finite_array(message.effort, len(given), 'effort')
        return dict(zip(given, forces.tolist())), {}
    if len(message.effort):
        raise MessageError(
            'position',
            'none beside efforts: centres of pressure are commanded in '
            'a message of their own',
            list(message.position),
        )
    centres = finite_array(message.position, len(given), 'position')
    return {}, dict(zip(given, centres.tolist()))


def read_motion(message: MultiDOFJointTrajectoryPoint) -> MotionReading:
    """
    Return the commanded motion of the operational point, in world axes.

    Twist and acceleration that are left out are zero. MessageError if there is another number of
    poses than one, a number is not finite, or the quaternion is longer or shorter than 1 by more
    than `UNIT_QUATERNION_TOLERANCE`.
    """
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


def read_trajectory(message: MultiDOFJointTrajectory) -> TimedPoses:
    """
    Return the timed poses of a path of the operational point, in world axes; none of an empty one.

    MessageError names the first point, from 0 on, that `read_motion` refuses, or that alone has a
    twist, or none. Accelerations are not used.
    """
    readings = []
    times = []
    for index, point in enumerate(message.points):
        try:
            readings.append(read_motion(point))
        except MessageError as error:
            raise MessageError(
                f'point {index}: {error.field}', error.expected, error.got
            ) from None
        if len(point.velocities) != len(message.points[0].velocities):
            raise MessageError(
                f'point {index}: velocities', 'one at all points, or at none'
            )
        times.append(stamp_to_ns(point.time_from_start) / NANOSECONDS)
    twists = None
    if readings and message.points[0].velocities:
        twists = np.array([reading.twist_world for reading in readings])
    return TimedPoses(
        np.array(times),
        np.array([reading.position_world for reading in readings]).reshape(-1, 3),
        np.array([reading.quaternion_xyzw for reading in readings]).reshape(-1, 4),
        twists,
    )


def trajectory_message(points: TimedPoses) -> MultiDOFJointTrajectory:
    """Return the command of a path; MessageError names the first point that is no number."""
    message = MultiDOFJointTrajectory(joint_names=['operational_point'])
    for index, time in enumerate(points.times.tolist()):
        twist = np.zeros(6)
        if points.twists_world is not None:
            twist = points.twists_world[index]
        try:
            point = motion_message(
                points.positions_world[index],
                points.quaternions_xyzw[index],
                twist,
                np.zeros(6),
            )
        except MessageError as error:
            raise MessageError(
                f'point {index}: {error.field}', error.expected, error.got
            ) from None
        point.accelerations = []
        if points.twists_world is None:
            point.velocities = []
        stamp = ns_to_stamp(round(time * NANOSECONDS))
        point.time_from_start = Duration(sec=stamp.sec, nanosec=stamp.nanosec)
        message.points.append(point)
    return message


def _read_twist(twists: Sequence[Twist], field: str) -> Vector:
    """Return the only twist of a list, zero if there is none, shape (6,), linear first."""
    if len(twists) > 1:
        raise MessageError(field, 'at most one', f'{len(twists)}')
    if not twists:
        return np.zeros(6)
    (twist,) = twists
    return finite_array(_list_numbers('xyz', twist.linear, twist.angular), 6, field)


def _list_numbers(axes: str, *parts: Any) -> list[float]:
    """Return the numbers of vectors or quaternions, one after the other."""
    return [getattr(part, axis) for part in parts for axis in axes]


def pose_arrays(pose: Pose) -> tuple[Vector, Vector]:
    """Return the position of a pose, shape (3,) [m], and its quaternion x, y, z, w, shape (4,)."""
    position = np.array(_list_numbers('xyz', pose.position))
    quaternion_xyzw = np.array(_list_numbers('xyzw', pose.orientation))
    return position, quaternion_xyzw


def _set_numbers(values: ArrayLike, field: str, axes: str, *parts: Any) -> None:
    """Put numbers into vectors or quaternions, one after the other."""
    numbers = iter(finite_array(values, len(axes) * len(parts), field).tolist())
    for part in parts:
        for axis in axes:
            setattr(part, axis, next(numbers))


def joint_state_message(
    stamp: int, names: Sequence[str], **fields: ArrayLike
) -> JointState:
    """
    Return a message of numbers by name.

    Parameters
    ----------
    stamp
        Time of the sample [ns].
    names
        One per number, e.g. joints or contacts.
    fields
        Numbers of some of `JOINT_FIELDS`, each of shape (names,).

    Raises
    ------
    MessageError
        If a field has another length or a number that is not finite.

    """
    arrays = {}
    for field, values in fields.items():
        numbers = finite_array(values, len(names), field)
        arrays[field] = array('d', numbers.tobytes())
    return JointState(
        header=Header(stamp=ns_to_stamp(stamp)), name=list(names), **arrays
    )


def motion_message(
    position_world: ArrayLike,
    quaternion_xyzw: ArrayLike,
    twist_world: ArrayLike,
    acceleration_world: ArrayLike,
) -> MultiDOFJointTrajectoryPoint:
    """
    Return the command of a motion of the operational point.

    Parameters
    ----------
    position_world, quaternion_xyzw
        Its pose in world axes, shape (3,) [m], and a unit quaternion, shape (4,).
    twist_world, acceleration_world
        Linear first, in world axes, shape (6,) [m/s, rad/s] and [m/s^2, rad/s^2].

    Raises
    ------
    MessageError
        If an array has another length or a number that is not finite.

    """
    pose = Transform()
    twist = Twist()
    acceleration = Twist()
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
    """
    What the controller says of itself on ``~/status``, and of a command.

    Texts are words for an operator; lists in them are joined by commas, and empty for nothing.
    """

    event: str  # `accepted` or `refused` for a command, else `state`
    command: str  # its identifier; empty if it has none
    text: str  # why it is refused; else what the controller does, `ok` for what it is asked for
    life_cycle: str  # `active` or `inactive`
    reaction: str  # `none`, or what it does instead of control
    causes: str
    contacts: str  # the state of each in words
    held: bool  # on command
    refused: int  # commands so far
    # Of the command's topic, as far as the controller knows them, a recorder among them.
    readers: int
    push_test: str  # what it asks for; empty for nothing
    forces: Mapping[str, float]  # obeyed by contact and couple [N]; empty in a scenario
    # Joints whose efforts are of no use, and what is not watched therefore; empty for none.
    unwatched: str = ''
    # The part of an accepted command that is not obeyed; empty for nothing.
    left_out: str = ''
    # Of the trajectory that is followed: `moving`, `waiting` or `held`, the share of its time that
    # is over, and the seconds that remain; empty for none.
    trajectory: str = ''
    # N_i of contacts that are sought or held, along which a motion has no effect, by force and
    # couple, shape (6,).
    placing: Mapping[str, tuple[float, ...]] = dataclasses.field(default_factory=dict)

    @property
    def remaining_time(self) -> float | None:
        """Return how long the trajectory that is followed goes on [s], None if there is none."""
        if not self.trajectory:
            return None
        return float(self.trajectory.split(' ')[2])

    @property
    def trajectory_share(self) -> float:
        """Return the share of its time that is over of the trajectory, 1 if there is none."""
        if not self.trajectory:
            return 1.0
        return float(self.trajectory.split(' ')[1])

    @property
    def contact_states(self) -> dict[str, str]:
        """Return the state of each contact in words, e.g. `holding`, by its name."""
        return dict(each.split(' ', 1) for each in _split_list(self.contacts))

    @classmethod
    def from_message(cls, message: DiagnosticStatus) -> ControllerStatus:
        """Return the status in a message on ``~/status``: the inverse of `to_message`."""
        values = {value.key: value.value for value in message.values}
        forces = {}
        for each in _split_list(values['forces']):
            name, force = each.rsplit(' ', 1)
            forces[name] = float(force)
        placing = {}
        for each in _split_list(values['placing']):
            name, *column = each.split(' ')
            placing[name] = tuple(map(float, column))
        return cls(
            text=message.message,
            refused=int(values['refused']),
            readers=int(values['readers']),
            held=values['held'] == str(True),
            forces=forces,
            placing=placing,
            **{name: values[name] for name in STATUS_TEXTS},
        )

    def to_message(self, name: str, level: bytes) -> DiagnosticStatus:
        """
        Return the message that says so.

        Parameters
        ----------
        name, level
            Name of the status in the message, and its level, e.g. `DiagnosticStatus.WARN`.

        """
        forces = [f'{key} {force:.9g}' for key, force in self.forces.items()]
        placing = []
        for key, column in self.placing.items():
            numbers = [f'{number:.9g}' for number in column]
            placing.append(' '.join([key, *numbers]))
        values = {
            **{text: getattr(self, text) for text in STATUS_TEXTS},
            'refused': str(self.refused),
            'readers': str(self.readers),
            'held': str(self.held),
            'forces': ', '.join(forces),
            'placing': ', '.join(placing),
        }
        return DiagnosticStatus(
            name=name,
            level=level,
            message=self.text,
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )


# Fields of a status that a message has as they are; `text` is its own field there.
STATUS_TEXTS = tuple(
    field.name
    for field in dataclasses.fields(ControllerStatus)
    if field.type == 'str' and field.name != 'text'
)


def _split_list(text: str) -> list[str]:
    return text.split(', ') if text else []


def new_identifier() -> str:
    """Return a random identifier for a command, such that no other client has the same."""
    return str(1 + secrets.randbelow(2**31 - 1))


def set_identifier(command: Any, identifier: str) -> None:
    """
    Give a command on a topic an identifier, which `~/status` answers with.

    That of forces or a trajectory is any text; that of a motion a number of 31 bits, 0 for none.
    """
    if isinstance(command, WITH_HEADER):
        command.header.frame_id = identifier
    else:
        command.time_from_start.sec = int(identifier or 0)


def get_identifier(command: Any) -> str:
    """Return the identifier of a command on a topic, empty if it has none."""
    if isinstance(command, WITH_HEADER):
        return str(command.header.frame_id)
    number = command.time_from_start.sec
    return str(number) if number else ''
