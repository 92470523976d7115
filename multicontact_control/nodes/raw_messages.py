"""
Messages of the control rate as bytes: read in place, written into prepared ones.

All messages of a stream have the same bytes but for their stamp and their numbers, as long as
names and lengths stay. `find_places` says where these are. A `MessageReader` takes them from
there, and goes by way of the message class, checked in full, when anything else differs; a
`MessageTemplate` puts them there. Bytes are CDR (XCDR version 1) with its encapsulation header.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
import math
import struct
from typing import Any, Generic, TypeVar

from geometry_msgs.msg import WrenchStamped
from multicontact_control.arrays import Vector
from multicontact_control.errors import MessageError
from multicontact_control.force.noise import Innovation
from multicontact_control.nodes import messages
from multicontact_control.nodes.loop_statistics import NANOSECONDS
from multicontact_control.nodes.message_definitions import message_class
from multicontact_control.nodes.messages import all_finite, InnovationReading, NamedReading
from multicontact_control.sampling import JointReading, WrenchReading
import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

HEADER = 4  # bytes of the encapsulation: representation, options
LITTLE_ENDIAN, BIG_ENDIAN = b'\0\1', b'\0\0'
STAMP = struct.Struct('<iI')
SIZES = {'boolean': 1, 'octet': 1, 'char': 1, 'uint8': 1, 'int8': 1, 'uint16': 2, 'int16': 2,
         'uint32': 4, 'int32': 4, 'float': 4, 'uint64': 8, 'int64': 8, 'double': 8}
JOINT_FIELDS = ('position', 'velocity', 'effort')
STAMP_TYPE = 'builtin_interfaces/Time'

Reading = TypeVar('Reading')
Index = NDArray[np.int64]
Arrangement = tuple[Sequence[int], Index | None]


@dataclass
class Places:
    """
    Where everything stands in the bytes of a message; what is nowhere is padding.

    Attributes
    ----------
    end
        Number of bytes.
    stamp
        Where the first time stands, -1 without one.
    numbers
        Where doubles stand: first byte and count of each run of them.
    constants
        First and last byte, exclusive, of everything else.
    fields
        First byte of the values of each field, by its path, e.g. `markers/0/color/r`.

    """

    end: int = HEADER
    stamp: int = -1
    numbers: list[tuple[int, int]] = field(default_factory=list)
    constants: list[tuple[int, int]] = field(default_factory=list)
    fields: dict[str, int] = field(default_factory=dict)

    def add_numbers(self, start: int, count: int) -> None:
        """Note some doubles, one run with those right before."""
        if self.numbers and self.numbers[-1][0] + 8 * self.numbers[-1][1] == start:
            start, before = self.numbers.pop()
            count += before
        self.numbers.append((start, count))


class _Walk:
    """One way through the bytes of a message, along the fields of its class."""

    def __init__(self, data: bytes) -> None:
        if data[:2] not in (LITTLE_ENDIAN, BIG_ENDIAN):
            raise MessageError('encapsulation', 'CDR, 0 0 or 0 1', list(data[:2]))
        self._data = data
        self._order = '<I' if data[:2] == LITTLE_ENDIAN else '>I'
        self.places = Places()

    def message(self, class_: Any, path: str = '') -> None:
        """Go along a message, which stands in another one at some path."""
        for name, kind in class_.get_fields_and_field_types().items():
            if kind.startswith('sequence<'):
                self._values(kind[len('sequence<'):-1], self._length(), path + name, '/{}')
            else:
                self._values(kind, 1, path + name)

    def _values(self, kind: str, count: int, path: str, place: str = '') -> None:
        places = self.places
        if kind == 'double':
            if count:
                places.fields[path] = self._pass(8, count)
                places.add_numbers(places.fields[path], count)
        elif kind == 'string':
            for _ in range(count):
                length = self._length()
                self._constant(self._pass(1, length), length)
        elif kind in SIZES:
            places.fields[path] = self._pass(SIZES[kind], count)
            self._constant(places.fields[path], SIZES[kind] * count)
        elif kind == STAMP_TYPE and places.stamp < 0:
            places.stamp = places.fields[f'{path}/sec'] = self._pass(4, 2)
        elif '[' in kind:
            raise TypeError(f'messages with fields of type {kind} are not read in place')
        else:
            part = message_class(kind.replace('/', '/msg/'))
            for k in range(count):
                self.message(part, f'{path}{place.format(k)}/')

    def _constant(self, start: int, size: int) -> None:
        self.places.constants.append((start, start + size))

    def _length(self) -> int:
        start = self._pass(4, 1)
        self._constant(start, 4)
        return int(struct.unpack_from(self._order, self._data, start)[0])

    def _pass(self, size: int, count: int) -> int:
        """Go past some values; return where they begin, aligned to the size of one."""
        start = self.places.end + -(self.places.end - HEADER) % size
        end = start + size * count
        if end > len(self._data):
            raise MessageError('data', f'at least {end} bytes', len(self._data))
        self.places.end = end
        return start


def find_places(class_: Any, data: bytes) -> Places:
    """
    Find where stamp, numbers and the rest stand in a message.

    Parameters
    ----------
    class_
        Its class: of numbers, strings, sequences of them and messages of these.
    data
        CDR with its encapsulation header, of either byte order.

    Raises
    ------
    MessageError
        If the bytes are not CDR, or end too early for the lengths that stand in them.

    """
    walk = _Walk(data)
    walk.message(class_)
    return walk.places


class MessageTemplate:
    """
    A message whose stamp and numbers are read and written where they stand in its bytes.

    Parameters
    ----------
    class_
        Its class, which begins with a time.
    data
        One such message, little endian.

    Attributes
    ----------
    lengths
        Lengths of the runs of numbers.

    """

    def __init__(self, class_: Any, data: bytes) -> None:
        places = find_places(class_, data)
        self._size, self._stamp = places.end, places.stamp
        self.lengths = tuple(count for _, count in places.numbers)
        # From the first number on all are at multiples of 8 bytes from each other, so that one
        # array covers them; what is between two runs is a length and means nothing as a number.
        first = places.numbers[0][0] if places.numbers else places.end
        self._first = first
        self._runs = [slice((start - first) // 8, (start - first) // 8 + count)
                      for start, count in places.numbers]
        self._covered = self._runs[-1].stop if self._runs else 0
        self._constants = _constants(places)
        self._expected = self._constants.unpack_from(data)
        self._bytes = bytearray(self._size)  # padding is 0
        for start, end in ((0, 2), *places.constants):
            self._bytes[start:end] = data[start:end]
        self._all = np.frombuffer(
            self._bytes, dtype='<f8', count=self._covered, offset=first) if (
                self._covered) else np.zeros(0)
        self._views = [self._all[run] for run in self._runs]

    def read(self, data: bytes) -> tuple[int, list[Vector]] | None:
        """
        Return stamp [ns] and runs of numbers of a message.

        None if anything but these differs from the template's, or the stamp is none. What follows
        the message in its bytes means nothing, to rclpy as well.
        """
        if len(data) < self._size or self._constants.unpack_from(data) != self._expected:
            return None
        sec, nanosec = STAMP.unpack_from(data, self._stamp)
        if nanosec >= NANOSECONDS:
            return None
        # A copy: bytes need not begin at a multiple of 8 in memory, which numba asks for.
        numbers = np.frombuffer(data, '<f8', self._covered, self._first).copy()
        return sec * NANOSECONDS + nanosec, [numbers[run] for run in self._runs]

    def write(self, stamp: int, *runs: Vector) -> bytes:
        """
        Return the message with another stamp [ns] and other numbers.

        Parameters
        ----------
        stamp, runs
            The stamp, and the numbers of each run, of its length.

        Raises
        ------
        MessageError
            If a number is not finite, or the stamp is beyond those of ROS.

        """
        sec, nanosec = messages.split_stamp(stamp)
        for view, values in zip(self._views, runs):
            view[:] = values
        if not all_finite(self._all):
            raise MessageError('numbers', 'finite ones', [run.tolist() for run in runs])
        STAMP.pack_into(self._bytes, self._stamp, sec, nanosec)
        return bytes(self._bytes)


def _constants(places: Places) -> struct.Struct:
    """Return what reads representation and constants of a message, and passes over the rest."""
    text, at = '<2s', 2
    for start, end in places.constants:
        text += f'{start - at}x{end - start}s'
        at = end
    return struct.Struct(text)


class MessageReader(Generic[Reading]):
    """
    Reads the messages of one topic from their bytes.

    The layout is that of the last message that was read by way of its class and is in order.

    Parameters
    ----------
    class_
        Of the topic.
    by_class
        Reads a message; raises `MessageError` if it cannot be used.
    arrange
        Returns which runs of its numbers make up a reading, and which numbers of each, None for
        all as they are; or None if it cannot be read in place.
    by_numbers
        Makes the reading of a stamp and these runs.

    Attributes
    ----------
    slow
        How many messages went by way of their class.

    """

    def __init__(
        self, class_: Any, by_class: Callable[[Any], Reading],
        arrange: Callable[[Any], Arrangement | None],
        by_numbers: Callable[..., Reading],
    ) -> None:
        self._class = class_
        self._by_class, self._arrange, self._by_numbers = by_class, arrange, by_numbers
        self._template: MessageTemplate | None = None
        self._runs: Sequence[int] = ()
        self._places: Index | None = None
        self.slow = 0

    def read(self, data: bytes) -> Reading:
        """
        Return the reading in a message.

        Raises
        ------
        MessageError
            If the bytes are no message of this class, or it cannot be used.

        """
        found = self._template.read(data) if self._template is not None else None
        if found is not None:
            stamp, numbers = found
            runs = [numbers[run] for run in self._runs]
            if self._places is not None:
                runs = [run[self._places] for run in runs]
            if all(map(all_finite, runs)):
                return self._by_numbers(stamp, *runs)
        return self._read_by_class(data)

    def _read_by_class(self, data: bytes) -> Reading:
        self.slow += 1
        find_places(self._class, data)  # lengths are believed only if there are so many bytes
        try:
            message = deserialize_message(data, self._class)
        except Exception as error:  # of whatever kind the middleware raises
            raise MessageError('data', f'a {self._class.__name__}', error) from None
        reading = self._by_class(message)
        arrangement = self._arrange(message)
        if arrangement is not None and data[:2] == LITTLE_ENDIAN:
            self._template = MessageTemplate(self._class, data)
            self._runs, self._places = arrangement
        return reading


def joint_state_reader(names: Sequence[str]) -> MessageReader[JointReading]:
    """Return a reader of the positions, velocities and, where there are any, efforts of joints."""
    def make(stamp: int, q: Vector, qd: Vector, effort: Vector | None = None) -> JointReading:
        return JointReading(stamp, q, qd, effort)

    def arrange(message: Any) -> Arrangement | None:
        if not names:
            return None
        places = messages.places_among(message.name, names)
        efforts = message.effort
        with_effort = len(efforts) == len(message.name)
        if with_effort and not all(math.isfinite(efforts[place]) for place in places):
            return None  # they are not measured in this message, but may be in the next
        as_they_are = places == list(range(len(message.name)))
        return (_runs(message, JOINT_FIELDS if with_effort else JOINT_FIELDS[:2]),
                None if as_they_are else np.array(places))

    return MessageReader(
        JointState, lambda message: messages.read_joint_state(message, names), arrange, make)


def effort_reader(names: Sequence[str]) -> MessageReader[NamedReading]:
    """Return a reader of one effort per name; see `messages.read_effort`."""
    return MessageReader(
        JointState, lambda message: messages.read_effort(message, names),
        lambda message: _named_runs(message, names, ('effort',)), NamedReading)


def innovation_reader(names: Sequence[str]) -> MessageReader[InnovationReading]:
    """Return a reader of innovations; see `messages.read_innovation`."""
    def make(stamp: int, used: Vector, prior: Vector, innovation: Vector) -> InnovationReading:
        return InnovationReading(stamp, Innovation(innovation, prior, used))

    return MessageReader(
        JointState, lambda message: messages.read_innovation(message, names),
        lambda message: _named_runs(message, names, JOINT_FIELDS), make)


def wrench_reader(
    frame: str = '', on_nameless: Callable[[], None] = lambda: None,
) -> MessageReader[WrenchReading]:
    """
    Return a reader of wrenches, force first.

    Parameters
    ----------
    frame
        Frame that they must be of; see `messages.read_wrench`.
    on_nameless
        Called when messages begin to come that name no frame.

    """
    def by_class(message: Any) -> WrenchReading:
        reading = messages.read_wrench(message, frame)
        if frame and not message.header.frame_id:
            on_nameless()
        return reading

    return MessageReader(
        WrenchStamped, by_class, lambda message: ((0,), None), WrenchReading)


def _named_runs(
    message: Any, names: Sequence[str], fields: Sequence[str],
) -> Arrangement | None:
    """Return which runs of numbers fields of a JointState are, None in another order."""
    if not names or list(message.name) != list(names):
        return None
    return _runs(message, fields), None


def _runs(message: Any, fields: Sequence[str]) -> Sequence[int]:
    """Return which runs of numbers of a JointState its fields are."""
    filled = [field for field in JOINT_FIELDS if len(getattr(message, field))]
    return [filled.index(field) for field in fields]


def template_of(message: Any) -> MessageTemplate:
    """Return the template of the messages that are like this one but for stamp and numbers."""
    return MessageTemplate(type(message), serialize_message(message))
