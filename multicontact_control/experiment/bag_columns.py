"""The messages of one topic of a recording as columns of numbers; needs no ROS installation."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from typing import Any

from multicontact_control.arrays import Matrix
import numpy as np
from numpy.typing import NDArray

JOINT_STATE, WRENCH, POSE = (
    'sensor_msgs/msg/JointState', 'geometry_msgs/msg/WrenchStamped',
    'geometry_msgs/msg/PoseStamped')
MARKERS = 'visualization_msgs/msg/MarkerArray'

# Names of the numbers of a field, where the message has none.
AXES = {
    'wrench': ('force.x', 'force.y', 'force.z', 'torque.x', 'torque.y', 'torque.z'),
    'point': ('x', 'y', 'z'), 'quaternion': ('x', 'y', 'z', 'w')}
# Fields of the messages of a type that are kept, in the order in which its reader has them.
FIELDS: dict[str, tuple[str, ...]] = {
    JOINT_STATE: ('position', 'velocity', 'effort'), WRENCH: ('wrench',),
    POSE: ('point', 'quaternion'), MARKERS: ('x', 'y', 'z')}

Numbers = tuple[Sequence[float], ...]


def _joint_state(message: Any) -> Numbers:
    return message.position, message.velocity, message.effort


def _wrench(message: Any) -> Numbers:
    force, torque = message.wrench.force, message.wrench.torque
    return ((force.x, force.y, force.z, torque.x, torque.y, torque.z),)


def _pose(message: Any) -> Numbers:
    p, q = message.pose.position, message.pose.orientation
    return (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)


def _markers(message: Any) -> Numbers:
    places = [marker.pose.position for marker in message.markers]
    return [p.x for p in places], [p.y for p in places], [p.z for p in places]


READERS: dict[str, Callable[[Any], Numbers]] = {
    JOINT_STATE: _joint_state, WRENCH: _wrench, POSE: _pose, MARKERS: _markers}
# Of messages whose numbers have names, those names.
NAMES: dict[str, Callable[[Any], tuple[str, ...]]] = {
    JOINT_STATE: lambda message: tuple(message.name),
    MARKERS: lambda message: tuple(marker.ns.rpartition('/')[2] for marker in message.markers)}

Layout = tuple[tuple[str, ...], tuple[int, ...]]  # names, and how many numbers a field has


class BagColumns:
    """
    What the messages of one topic say, in the order of the recording.

    A message is taken apart as it is read: 8 bytes for each of its numbers are kept, and 24.

    Parameters
    ----------
    type_name
        One of `FIELDS`.

    """

    def __init__(self, type_name: str) -> None:
        self._fields, self._read = FIELDS[type_name], READERS[type_name]
        self._names = NAMES.get(type_name, lambda message: ())
        self._of_markers = type_name == MARKERS
        self._stamps, self._published = array('q'), array('Q')
        # Rows and numbers of messages with the same names: several nodes may share a topic.
        self._parts: dict[Layout, tuple[array[int], array[float]]] = {}

    def take(self, message: Any, published: int) -> None:
        """
        Add a message, or nothing if it is not such a message.

        Parameters
        ----------
        message
            With a header, or markers with one.
        published
            When it was sent [ns since the epoch].

        """
        stamp = (message.markers[0] if self._of_markers else message).header.stamp
        fields, names = self._read(message), self._names(message)
        numbers = array('d', [number for values in fields for number in values])
        stamps = array('q', [stamp.sec * 1_000_000_000 + stamp.nanosec])
        when = array('Q', [published])
        rows, kept = self._parts.setdefault(
            (names, tuple(map(len, fields))), (array('q'), array('d')))
        rows.append(len(self))
        kept.extend(numbers)
        self._stamps.extend(stamps)
        self._published.extend(when)

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self._stamps)

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Stamps of the headers, shape (m,) [ns]."""
        return np.array(self._stamps, dtype=np.int64)

    @property
    def published(self) -> NDArray[np.uint64]:
        """When the messages were sent, shape (m,) [ns since the epoch]."""
        return np.array(self._published, dtype=np.uint64)

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the first message that has any."""
        return next((names for names, _ in self._parts if names), ())

    def values(self, field: str, names: Sequence[str] = ()) -> Matrix:
        """
        Return the numbers of a field, shape (m, k); NaN where a message has none of a name.

        Parameters
        ----------
        field
            One of `FIELDS` of the type.
        names
            Order of the columns, of messages with names.

        """
        names, place = AXES.get(field, names), self._fields.index(field)
        found = np.full((len(self), len(names)), np.nan)
        for (known, widths), (rows, numbers) in self._parts.items():
            known = known or AXES.get(field, ())
            first = sum(widths[:place])
            columns = dict(zip(known, range(first, first + widths[place])))
            block = np.asarray(numbers).reshape(len(rows), sum(widths))
            for column, name in enumerate(names):
                if name in columns:
                    found[rows, column] = block[:, columns[name]]
        return found
