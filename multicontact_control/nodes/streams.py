"""
Messages at the control rate as bytes: with message objects the graph is a third slower.

All messages of a stream have the same bytes but for their stamp and their numbers.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from itertools import count
import math
import struct
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.errors import MessageError
from multicontact_control.nodes.graph import create_publisher
from multicontact_control.nodes.messages import finite_array, LAST_SECOND
from multicontact_control.nodes.topics import Topic
from multicontact_control.sampling import NANOSECONDS
import numpy as np
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

STAMP, HEADER = struct.Struct('<iI'), 4  # after so many bytes
LITTLE_ENDIAN = b'\0\1'  # begins a message
(MARK,) = struct.unpack(
    '<d', bytes(range(1, 9))
)  # a number that is nowhere else in a message


class StreamPublisher:
    """Publishes messages like a pattern, which ends with a number, but for stamp and numbers."""

    def __init__(self, node: Node, topic: Topic, pattern: Any) -> None:
        publisher = create_publisher(node, topic)
        self.publish, self._readers = (
            publisher.publish,
            publisher.get_subscription_count,
        )
        data, self._places = locate_numbers(pattern)
        self._bytes = bytearray(data)
        self._numbers = _words(self._bytes)

    def encode_message(self, stamp: int, *numbers: Vector) -> bytes:
        """Return the message with a stamp [ns], and numbers in their order; MessageError."""
        values = np.concatenate(numbers)
        if values.size != len(self._places) or not math.isfinite(values.sum()):
            finite_array(values, len(self._places), 'numbers')  # raises what is wrong
        sec, nanosec = divmod(stamp, NANOSECONDS)
        if abs(sec) > LAST_SECOND:
            raise MessageError('stamp.sec', f'at most {LAST_SECOND}', sec)
        self._numbers[self._places] = values
        STAMP.pack_into(self._bytes, HEADER, sec, nanosec)
        return bytes(self._bytes)

    def publish_if_subscribed(self, stamp: int, *numbers: Vector) -> None:
        """Publish a message with a stamp [ns] and numbers, if it is subscribed to."""
        if self._readers():
            self.publish(self.encode_message(stamp, *numbers))


class MessageReader:
    """
    Reads messages from their bytes: those that are like the last one in place.

    `read` returns the stamp of a message object and vectors of its numbers, or raises
    `MessageError`; it is asked again whenever anything but stamp and numbers changes.
    """

    def __init__(self, class_: Any, read: Callable[[Any], tuple[Any, ...]]) -> None:
        self._class, self._read = class_, read
        self._length, self._word_count = -1, 0  # of a message like the last one

    def __call__(self, data: bytes) -> tuple[Any, ...]:
        """Return the stamp [ns] and the vectors in a message; MessageError."""
        if len(data) == self._length:
            sec, nanosec = STAMP.unpack_from(data, HEADER)
            words = np.frombuffer(data, np.float64, self._word_count, HEADER)
            if (
                words[self._others].tobytes() == self._constant
                and nanosec < NANOSECONDS
                and (math.isfinite(sum(words[self._used].tolist())))
            ):
                return sec * NANOSECONDS + nanosec, *(words[x] for x in self._vectors)
        return self._learn_layout(data)

    def _learn_layout(self, data: bytes) -> tuple[Any, ...]:
        """Read a message by way of its class, and keep where its numbers are."""
        self._length = -1
        try:
            message = deserialize_message(data, self._class)
        except Exception as error:  # of whatever kind the middleware raises
            raise MessageError('data', f'a {self._class.__name__}', error) from None
        reading, places = self._read(message), locate_numbers(message)[1]
        marks = [vector for vector in self._read(message)[1:] if vector is not None]
        if len(marks) == len(reading) - 1 and data[:2] == LITTLE_ENDIAN:
            self._vectors = [
                places[np.rint(marked / MARK).astype(int) - 1] for marked in marks
            ]
            self._used, words = np.concatenate(self._vectors), _words(data)
            self._others = np.delete(
                np.arange(len(words)), [0, *places]
            )  # 0 is the stamp
            self._constant, self._length = words[self._others].tobytes(), len(data)
            self._word_count = len(words)
        return reading


def locate_numbers(message: Any) -> tuple[bytes, Any]:
    """
    Set the numbers of a message to `MARK`, 2 `MARK`, 3 `MARK`...

    Returns its bytes up to the last, and where they are: in words of 8 bytes behind the header,
    where numbers are aligned. Bytes between, and behind the last, may be any.
    """
    marks = (MARK * k for k in count(1))
    _set_numbers(message, marks)
    total, data = round(next(marks) / MARK) - 1, serialize_message(message)
    words = _words(data)
    places = np.array(
        [np.flatnonzero(words == MARK * k)[0] for k in range(1, total + 1)], int
    )
    return data[: HEADER + 8 * (int(places.max(initial=-1)) + 1)], places


def _words(data: bytes | bytearray) -> Vector:
    return np.frombuffer(data, np.float64, (len(data) - HEADER) // 8, HEADER)


def _set_numbers(message: Any, numbers: Iterator[float]) -> None:
    for field in message.get_fields_and_field_types():
        part = getattr(message, field)
        if isinstance(part, float):
            setattr(message, field, next(numbers))
        elif isinstance(part, array):
            setattr(message, field, array('d', [next(numbers) for _ in part]))
        elif hasattr(part, 'get_fields_and_field_types'):
            _set_numbers(part, numbers)
