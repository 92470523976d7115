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
from multicontact_control.nodes.messages import finite_array, INPUT_SECONDS, SECONDS
from multicontact_control.nodes.topics import Topic
from multicontact_control.sampling import NANOSECONDS
import numpy as np
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

HEADER = 4  # bytes of CDR before the fields
STAMP = struct.Struct('<iI')  # behind the header: seconds and nanoseconds
WORD = 8  # bytes of a number; numbers are aligned to words behind the header
LITTLE_ENDIAN = b'\0\1'  # begins a message
# A number whose multiples are nowhere else in a message.
(MARK,) = struct.unpack('<d', bytes(range(1, 9)))


class StreamPublisher:
    """
    Publishes messages that differ from a pattern in stamp and numbers alone.

    Parameters
    ----------
    node, topic
        The node that publishes, and the topic.
    pattern
        A message object with the names, frames and number of numbers of all; its last field is a
        number.

    Attributes
    ----------
    publish
        Publishes the bytes of a message.

    """

    def __init__(self, node: Node, topic: Topic, pattern: Any) -> None:
        publisher = create_publisher(node, topic)
        self.publish = publisher.publish
        self._count_readers = publisher.get_subscription_count
        data, self._places = locate_numbers(pattern)
        self._bytes = bytearray(data)
        self._words = _view_words(self._bytes)

    def encode_message(self, stamp: int, *numbers: Vector) -> bytes:
        """
        Return the bytes of a message.

        Parameters
        ----------
        stamp
            Time of the sample [ns].
        numbers
            Vectors in the order of the message's fields, together as long as the pattern's.

        Raises
        ------
        MessageError
            If a number is not finite, their count is another, or ROS has no such stamp.

        """
        values = np.concatenate(numbers)
        if values.size != len(self._places) or not math.isfinite(values.sum()):
            finite_array(values, len(self._places), 'numbers')  # raises the error
        seconds, nanoseconds = divmod(stamp, NANOSECONDS)
        if seconds not in SECONDS:
            raise MessageError('stamp.sec', f'{SECONDS[0]} to {SECONDS[-1]}', seconds)
        self._words[self._places] = values
        STAMP.pack_into(self._bytes, HEADER, seconds, nanoseconds)
        return bytes(self._bytes)

    def publish_if_subscribed(self, stamp: int, *numbers: Vector) -> None:
        """Publish a message as `encode_message` makes it, unless the topic has no reader."""
        if self._count_readers():
            self.publish(self.encode_message(stamp, *numbers))


class MessageReader:
    """
    Reads messages from their bytes: those that are like the last one in place.

    A message whose bytes differ from the last one in stamp and numbers alone is read where it is.
    Any other becomes a message object, which is checked, and whose layout is kept.

    Parameters
    ----------
    message_class
        Class of the messages.
    read
        Returns the stamp [ns] of a message object and vectors of its numbers, None for one that
        is missing; raises MessageError for what is unusable.

    """

    def __init__(
        self, message_class: Any, read: Callable[[Any], tuple[Any, ...]]
    ) -> None:
        self._message_class = message_class
        self._read = read
        self._length = -1  # of a message like the last one; -1 for none
        self._word_count = 0

    def __call__(self, data: bytes) -> tuple[Any, ...]:
        """Return the stamp [ns] and the vectors in a message; MessageError if it is unusable."""
        if len(data) == self._length:
            seconds, nanoseconds = STAMP.unpack_from(data, HEADER)
            words = np.frombuffer(data, np.float64, self._word_count, HEADER)
            if (
                words[self._constant_places].tobytes() == self._constant_bytes
                and nanoseconds < NANOSECONDS
                and seconds in INPUT_SECONDS
                and math.isfinite(sum(words[self._number_places].tolist()))
            ):
                vectors = [words[places] for places in self._vector_places]
                return seconds * NANOSECONDS + nanoseconds, *vectors
        return self._read_object(data)

    def _read_object(self, data: bytes) -> tuple[Any, ...]:
        """Read a message as an object, and keep where its numbers are in the bytes."""
        self._length = -1
        try:
            message = deserialize_message(data, self._message_class)
        except Exception as error:  # of whatever kind the middleware raises
            raise MessageError(
                'data', f'a {self._message_class.__name__}', error
            ) from None
        reading = self._read(message)
        _, places = locate_numbers(message)  # which are marked from here on
        marked_vectors = self._read(message)[1:]
        complete = all(vector is not None for vector in marked_vectors)
        if complete and data[:2] == LITTLE_ENDIAN:
            self._keep_layout(data, places, marked_vectors)
        return reading

    def _keep_layout(
        self, data: bytes, places: Any, marked_vectors: tuple[Vector, ...]
    ) -> None:
        """Keep where the numbers of vectors are, and the words that are equal in all messages."""
        self._vector_places = []
        for vector in marked_vectors:
            # From 1, in order of the bytes.
            numbers = np.rint(vector / MARK).astype(int)
            self._vector_places.append(places[numbers - 1])
        self._number_places = np.concatenate(self._vector_places)
        words = _view_words(data)
        stamp_place = 0
        self._constant_places = np.delete(np.arange(len(words)), [stamp_place, *places])
        self._constant_bytes = words[self._constant_places].tobytes()
        self._word_count = len(words)
        self._length = len(data)


def locate_numbers(message: Any) -> tuple[bytes, Any]:
    """
    Set the numbers of a message to `MARK`, 2 `MARK`, 3 `MARK`..., and find them in its bytes.

    Returns
    -------
    tuple[bytes, Any]
        The bytes up to the last number, and the places of all, in words of 8 bytes behind the
        header. Bytes between numbers, and behind the last, may be any.

    """
    marks = (MARK * number for number in count(1))
    _mark_numbers(message, marks)
    total = round(next(marks) / MARK) - 1
    data = serialize_message(message)
    words = _view_words(data)
    found = [
        np.flatnonzero(words == MARK * number)[0] for number in range(1, total + 1)
    ]
    places = np.array(found, int)
    end = int(places.max(initial=-1)) + 1
    return data[: HEADER + WORD * end], places


def _view_words(data: bytes | bytearray) -> Vector:
    return np.frombuffer(data, np.float64, (len(data) - HEADER) // WORD, HEADER)


def _mark_numbers(message: Any, marks: Iterator[float]) -> None:
    """Give the numbers of a message and of its parts the next marks, in order of the fields."""
    for field in message.get_fields_and_field_types():
        part = getattr(message, field)
        if isinstance(part, float):
            setattr(message, field, next(marks))
        elif isinstance(part, array):
            marked = [next(marks) for _ in part]
            setattr(message, field, array('d', marked))
        elif hasattr(part, 'get_fields_and_field_types'):
            _mark_numbers(part, marks)
