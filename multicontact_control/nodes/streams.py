"""
Messages of the control rate as bytes: read in place, written into prepared ones.

All messages of a stream have the same bytes but for their stamp and their numbers, as long as
names and lengths stay. Bytes are CDR (XCDR version 1) with its encapsulation header.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
import struct
from typing import Any, NamedTuple

from geometry_msgs.msg import WrenchStamped
from multicontact_control.arrays import Vector
from multicontact_control.errors import counted, MessageError
from multicontact_control.nodes.graph import create_publisher
from multicontact_control.nodes.topics import Topic
from multicontact_control.sampling import NANOSECONDS
from multicontact_control.supervision.inputs import WrenchInput
import numpy as np
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

LAST_SECOND = 2 ** 31 - 1  # that a stamp can hold
HEADER = 4  # bytes of the encapsulation: representation, options
STAMP = struct.Struct('<iI')
JOINT_FIELDS = ('position', 'velocity', 'effort')


class NamedReading(NamedTuple):
    """One number per name at a time [ns], in the order that was asked for."""

    stamp: int
    values: Vector


class MessageTemplate:
    """
    The bytes of a message, with the places of its stamp and of its numbers.

    A message is a time, or a header and then names and numbers; `runs` are slices of its numbers,
    of each list, or of all where there are none.
    """

    def __init__(self, message: Any) -> None:
        self.constants, runs = _lay_out(message)
        # From the first number on all are at multiples of 8 bytes from each other, so that one
        # array covers them; what is between two runs is a length and means nothing as a number.
        self.first = next((start for start, count in runs if count), self.constants.size)
        self.covered = (self.constants.size - self.first) // 8
        self.runs = [slice((start - self.first) // 8, (start - self.first) // 8 + count)
                     for start, count in runs]
        self.expected = self.constants.unpack_from(serialize_message(message))
        self._bytes = bytearray(self.constants.size)
        self.constants.pack_into(self._bytes, 0, *self.expected)
        self._numbers: Vector = np.ndarray(self.covered, '<f8', self._bytes, self.first)
        self._views = [self._numbers[run] for run in self.runs if run.stop > run.start]

    def write(self, stamp: int, *runs: Vector) -> bytes:
        """Return the message with another stamp [ns], and other numbers in its runs."""
        for view, values in zip(self._views, runs):
            view[:] = values
        if not math.isfinite(sum(self._numbers.tolist())):
            raise MessageError('numbers', 'finite ones', self._numbers.tolist())
        sec, nanosec = divmod(stamp, NANOSECONDS)
        if abs(sec) > LAST_SECOND:
            raise MessageError('stamp.sec', f'at most {LAST_SECOND}', sec)
        STAMP.pack_into(self._bytes, HEADER, sec, nanosec)
        return bytes(self._bytes)


def _lay_out(message: Any) -> tuple[struct.Struct, list[tuple[int, int]]]:
    """Return what all messages have in common, and first byte and count of each run."""
    text, at, runs = f'<2s{2 + STAMP.size}x', HEADER + STAMP.size, []

    def add(size: int, kind: str = 's', align: int = 4) -> None:
        nonlocal text, at
        padding = (HEADER - at) % align  # counts from the end of the encapsulation
        text += f'{padding}x{size}{kind}'
        at += padding + size

    def add_run(count: int) -> None:
        if count:
            add(8 * count, 'x', 8)
        runs.append((at - 8 * count, count))

    if hasattr(message, 'header'):
        add(5 + len(message.header.frame_id.encode()))
    if isinstance(message, JointState):
        add(4)
        for name in message.name:
            add(5 + len(name.encode()))
        for field in JOINT_FIELDS:
            add(4)
            add_run(len(getattr(message, field)))
    elif hasattr(message, 'header'):
        add_run(6 if isinstance(message, WrenchStamped) else 7)
    return struct.Struct(text), runs


class MessageReader:
    """
    Reads the messages of one topic from their bytes.

    Frame, names and lengths are checked by way of the message class, again when they change
    (`slow` counts that); stamp and numbers are taken from where they stand. `arrange` returns
    where the vectors called `fields` are, from a message and the runs of its template; `make`
    makes a reading of the stamp and these vectors; the `optional` ones are None where they are
    missing or not finite. Both raise `MessageError` if a message cannot be used.
    """

    def __init__(
        self, class_: Any, fields: Sequence[str],
        arrange: Callable[[Any, list[slice]], Sequence[Any]], make: Callable[..., Any],
        optional: Sequence[str] = (),
    ) -> None:
        self._class, self._fields, self._optional = class_, fields, optional
        self._arrange, self._make = arrange, make
        self._template: MessageTemplate | None = None
        self._places: Sequence[Any] = ()
        self.slow = 0

    def read(self, data: bytes) -> Any:
        """Return the reading in a message; MessageError if it is none, or cannot be used."""
        known = self._template
        if known is None or len(data) < known.constants.size or (
                known.constants.unpack_from(data) != known.expected):
            known, data = self._learn(data)
        sec, nanosec = STAMP.unpack_from(data, HEADER)
        if nanosec >= NANOSECONDS:
            raise MessageError('stamp.nanosec', f'below {NANOSECONDS}', nanosec)
        # A copy: bytes need not begin at a multiple of 8 in memory, which numba asks for.
        numbers: Vector = np.ndarray(known.covered, '<f8', data, known.first).copy()
        vectors: list[Vector | None] = []
        for field, place in zip(self._fields, self._places):
            vector = numbers[place]
            finite = math.isfinite(sum(vector.tolist()))
            if not finite and field not in self._optional:
                raise MessageError(field, 'finite numbers', vector.tolist())
            vectors.append(vector if finite and len(vector) else None)
        return self._make(sec * NANOSECONDS + nanosec, *vectors)

    def _learn(self, data: bytes) -> tuple[MessageTemplate, bytes]:
        """Check a message by way of its class, and take its layout for that of the next."""
        self.slow += 1
        try:
            message = deserialize_message(data, self._class)
            data = serialize_message(message)  # it may have come in another representation
            template = MessageTemplate(message)
        except Exception as error:  # of whatever kind the middleware raises
            raise MessageError('data', f'a {self._class.__name__}', error) from None
        self._places, self._template = self._arrange(message, template.runs), template
        return template, data


def named_reader(
    names: Sequence[str], fields: Sequence[str], make: Callable[..., Any],
    optional: Sequence[str] = (),
) -> MessageReader:
    """Return a reader of these fields of a JointState, by name, in the order of `names`."""
    def arrange(message: JointState, runs: list[slice]) -> Sequence[Any]:
        given = list(message.name)
        if any(given.count(name) != 1 for name in names):
            raise MessageError('name', f'each of {list(names)} once', given)
        places: Any = np.array([given.index(name) for name in names], dtype=int)
        chosen = []
        for field in fields:
            length = len(getattr(message, field))
            if length != len(given) and field not in optional:
                raise MessageError(field, counted(len(given), 'values'), f'{length}')
            place = runs[JOINT_FIELDS.index(field)].start + places
            chosen.append(place if length == len(given) else place[:0])
        return chosen

    return MessageReader(JointState, fields, arrange, make, optional)


def variance_reader(names: Sequence[str]) -> MessageReader:
    """Return a reader of one variance above 0 per name [N^2]."""
    def make(stamp: int, values: Vector) -> NamedReading:
        if min(values.tolist()) <= 0.0:
            raise MessageError('effort', 'variances above 0', values.tolist())
        return NamedReading(stamp, values)

    return named_reader(names, ('effort',), make)


def wrench_reader(frame: str = '') -> MessageReader:
    """Return a reader of wrenches, force first, in a frame or in none; empty for any."""
    def arrange(message: WrenchStamped, runs: list[slice]) -> Sequence[Any]:
        given = message.header.frame_id.lstrip('/')
        if frame and given not in ('', frame):
            raise MessageError('header.frame_id', f"'{frame}' (robot.sensor_frame), or none",
                               f"'{given}'")
        return runs

    return MessageReader(WrenchStamped, ('wrench',), arrange, WrenchInput)


class StreamPublisher:
    """Publishes messages like a pattern but for stamp [ns] and numbers, as bytes."""

    def __init__(self, node: Node, topic: Topic, pattern: Any) -> None:
        publisher = create_publisher(node, topic)
        self.write, self.publish = MessageTemplate(pattern).write, publisher.publish
        self._readers = publisher.get_subscription_count

    def send(self, stamp: int, *runs: Vector) -> None:
        """Publish a message with numbers in its order, if it is subscribed to."""
        if self._readers():
            self.publish(self.write(stamp, *runs))
