"""
Messages of the control rate as bytes: read in place, written into prepared ones.

All messages of a stream have the same bytes but for their stamp and their numbers, as long as
names and lengths stay. A `MessageReader` takes these from where they stand, and goes by way of the
message class, checked in full, when anything else differs; a `MessageTemplate` puts them there.
Bytes are CDR (XCDR version 1) with its encapsulation header, and the messages begin with a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
import struct
from typing import Any, Generic, TypeVar

from geometry_msgs.msg import WrenchStamped
from multicontact_control.arrays import Vector
from multicontact_control.errors import MessageError
from multicontact_control.force.noise import Innovation
from multicontact_control.nodes import messages
from multicontact_control.nodes.loop_statistics import NANOSECONDS
from multicontact_control.nodes.messages import all_finite, InnovationReading, NamedReading
from multicontact_control.sampling import JointReading, WrenchReading
import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

HEADER = 4  # bytes of the encapsulation: representation, options
STAMP = struct.Struct('<iI')
JOINT_FIELDS = ('position', 'velocity', 'effort')

Reading = TypeVar('Reading')
Index = NDArray[np.int64]
Arrangement = tuple[Sequence[int], Index | None]
Places = list[tuple[int, int]]


class MessageTemplate:
    """
    A message whose stamp and numbers are read and written where they stand in its bytes.

    Parameters
    ----------
    message
        One such message: a time, then strings and doubles, and lists of both.

    """

    def __init__(self, message: Any) -> None:
        constants: Places = [(0, 2)]
        numbers: Places = []
        self._size = _lay_out(message, HEADER, constants, numbers)
        # From the first number on all are at multiples of 8 bytes from each other, so that one
        # array covers them; what is between two runs is a length and means nothing as a number.
        self._first = numbers[0][0] if numbers else self._size
        self._runs = [slice((start - self._first) // 8, (start - self._first) // 8 + count)
                      for start, count in numbers]
        self._covered = self._runs[-1].stop if self._runs else 0
        data, text, at = serialize_message(message), '<', 0
        self._bytes = bytearray(self._size)  # padding is 0
        for start, end in constants:
            self._bytes[start:end] = data[start:end]
            text += f'{start - at}x{end - start}s'
            at = end
        self._constants = struct.Struct(text)
        self._expected = self._constants.unpack_from(self._bytes)
        self._all = np.frombuffer(self._bytes, '<f8', self._covered, self._first) if (
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
        sec, nanosec = STAMP.unpack_from(data, HEADER)
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
        STAMP.pack_into(self._bytes, HEADER, sec, nanosec)
        return bytes(self._bytes)


def _lay_out(message: Any, at: int, constants: Places, numbers: Places) -> int:
    """
    Find where a message stands in its bytes, from place `at` on; return where it ends.

    Adds first and last byte, exclusive, of strings and lengths, and first byte and count of runs
    of doubles; alignment counts from the end of the encapsulation.
    """
    for name, kind in message.get_fields_and_field_types().items():
        values = getattr(message, name)
        if kind.startswith('sequence<'):
            kind = kind[len('sequence<'):-1]
            start = at + -at % 4
            at = start + 4
            constants.append((start, at))
        else:
            values = [values]
        if kind == 'double' and len(values):
            start = at + (HEADER - at) % 8
            at = start + 8 * len(values)
            if numbers and numbers[-1][0] + 8 * numbers[-1][1] == start:
                start, count = numbers.pop()
                numbers.append((start, count + len(values)))
            else:
                numbers.append((start, len(values)))
        for value in values if kind != 'double' else ():
            if kind == 'string':
                start = at + -at % 4
                at = start + 4 + len(value.encode()) + 1
                constants.append((start, at))
            elif kind == 'builtin_interfaces/Time':
                at += STAMP.size
            else:
                at = _lay_out(value, at, constants, numbers)
    return at


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
        try:
            message = deserialize_message(data, self._class)
        except Exception as error:  # of whatever kind the middleware raises
            raise MessageError('data', f'a {self._class.__name__}', error) from None
        reading = self._by_class(message)
        arrangement = self._arrange(message)
        if arrangement is not None:
            self._template = MessageTemplate(message)
            self._runs, self._places = arrangement
        return reading


def joint_state_reader(names: Sequence[str]) -> MessageReader[JointReading]:
    """Return a reader of the positions, velocities and, where there are any, efforts of joints."""
    def make(stamp: int, q: Vector, qd: Vector, effort: Vector | None = None) -> JointReading:
        return JointReading(stamp, q, qd, effort)

    def arrange(message: Any) -> Arrangement | None:
        with_effort = len(message.effort) == len(message.name)
        return _arrangement(message, names, JOINT_FIELDS if with_effort else JOINT_FIELDS[:2])

    return MessageReader(
        JointState, lambda message: messages.read_joint_state(message, names), arrange, make)


def effort_reader(names: Sequence[str]) -> MessageReader[NamedReading]:
    """Return a reader of one effort per name; see `messages.read_effort`."""
    return MessageReader(
        JointState, lambda message: messages.read_effort(message, names),
        lambda message: _arrangement(message, names, ('effort',)), NamedReading)


def innovation_reader(names: Sequence[str]) -> MessageReader[InnovationReading]:
    """Return a reader of innovations; see `messages.read_innovation`."""
    def make(stamp: int, used: Vector, prior: Vector, innovation: Vector) -> InnovationReading:
        return InnovationReading(stamp, Innovation(innovation, prior, used))

    return MessageReader(
        JointState, lambda message: messages.read_innovation(message, names),
        lambda message: _arrangement(message, names, JOINT_FIELDS), make)


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


def _arrangement(message: Any, names: Sequence[str], fields: Sequence[str]) -> Arrangement | None:
    """
    Return where fields of a JointState are among its runs of numbers, and names among its names.

    None if a number that is wanted is not one in this message: it may be in the next.
    """
    places = messages.places_among(message.name, names)
    values = [getattr(message, field)[place] for field in fields for place in places]
    if not all(map(math.isfinite, values)) or not names:
        return None
    filled = [field for field in JOINT_FIELDS if len(getattr(message, field))]
    as_they_are = places == list(range(len(message.name)))
    return [filled.index(field) for field in fields], None if as_they_are else np.array(places)
