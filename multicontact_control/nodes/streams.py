"""
Messages at the control rate, published as bytes: with message objects the graph is a third slower.

All messages of a stream have the same bytes but for their stamp and their numbers.
"""

from __future__ import annotations

from array import array
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
from rclpy.serialization import serialize_message

STAMP, HEADER = struct.Struct('<iI'), 4  # after so many bytes
MARK, = struct.unpack('<d', bytes(range(1, 9)))  # a number that is nowhere else in a message


class StreamPublisher:
    """Publishes messages like a pattern, which ends with a number, but for stamp and numbers."""

    def __init__(self, node: Node, topic: Topic, pattern: Any) -> None:
        publisher = create_publisher(node, topic)
        self.publish, self._readers = publisher.publish, publisher.get_subscription_count
        count, data = _mark_numbers(pattern), serialize_message(pattern)
        # Numbers are aligned behind the header; the bytes between, and behind the last, are any.
        words = np.frombuffer(data, np.float64, (len(data) - HEADER) // 8, HEADER)
        self._places = np.flatnonzero(words == MARK)[:count]
        self._bytes = bytearray(data[:HEADER + 8 * (int(self._places[-1]) + 1)])
        self._numbers = np.frombuffer(self._bytes, np.float64, offset=HEADER)

    def write(self, stamp: int, *numbers: Vector) -> bytes:
        """Return the message with a stamp [ns], and numbers in their order; MessageError."""
        values = finite_array(np.concatenate(numbers), len(self._places), 'numbers')
        sec, nanosec = divmod(stamp, NANOSECONDS)
        if abs(sec) > LAST_SECOND:
            raise MessageError('stamp.sec', f'at most {LAST_SECOND}', sec)
        self._numbers[self._places] = values
        STAMP.pack_into(self._bytes, HEADER, sec, nanosec)
        return bytes(self._bytes)

    def send(self, stamp: int, *numbers: Vector) -> None:
        """Publish a message with a stamp [ns] and numbers, if it is subscribed to."""
        if self._readers():
            self.publish(self.write(stamp, *numbers))


def _mark_numbers(message: Any) -> int:
    """Set all numbers of a message to `MARK`, and return how many there are."""
    count = 0
    for field in message.get_fields_and_field_types():
        part = getattr(message, field)
        if isinstance(part, float):
            setattr(message, field, MARK)
            count += 1
        elif isinstance(part, array):
            setattr(message, field, array('d', [MARK] * len(part)))
            count += len(part)
        elif hasattr(part, 'get_fields_and_field_types'):
            count += _mark_numbers(part)
    return count
