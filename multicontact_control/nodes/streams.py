"""
Messages at the control rate, published as bytes: with message objects the graph is a third slower.

All messages of a stream have the same bytes but for their stamp and their numbers.
"""

from __future__ import annotations

from array import array
import math
import struct
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.errors import MessageError
from multicontact_control.nodes.graph import create_publisher
from multicontact_control.nodes.messages import LAST_SECOND
from multicontact_control.nodes.topics import Topic
from multicontact_control.sampling import NANOSECONDS
import numpy as np
from rclpy.node import Node
from rclpy.serialization import serialize_message

STAMP, HEADER = struct.Struct('<iI'), 4  # after so many bytes
MARKS = tuple(struct.unpack('<d', byte * 8)[0] for byte in (b'\1', b'\2'))


class StreamPublisher:
    """Publishes messages like a pattern, which ends with a number, but for stamp and numbers."""

    def __init__(self, node: Node, topic: Topic, pattern: Any) -> None:
        publisher = create_publisher(node, topic)
        self.publish, self._readers = publisher.publish, publisher.get_subscription_count
        marked = []
        for mark in MARKS:  # two numbers that differ in every byte
            _set_numbers(pattern, mark)
            marked.append(np.frombuffer(serialize_message(pattern), np.uint8))
        self._places = np.flatnonzero(marked[0] != marked[1])
        # rclpy leaves some bytes beyond the last number.
        self._bytes = marked[0][:self._places[-1] + 1].copy()

    def write(self, stamp: int, *numbers: Vector) -> bytes:
        """Return the message with a stamp [ns], and numbers in their order; MessageError."""
        values = np.concatenate(numbers)
        if not math.isfinite(sum(values.tolist())):
            raise MessageError('numbers', 'finite ones', values.tolist())
        sec, nanosec = divmod(stamp, NANOSECONDS)
        if abs(sec) > LAST_SECOND:
            raise MessageError('stamp.sec', f'at most {LAST_SECOND}', sec)
        self._bytes[self._places] = values.view(np.uint8)
        STAMP.pack_into(self._bytes.data, HEADER, sec, nanosec)
        return self._bytes.tobytes()

    def send(self, stamp: int, *numbers: Vector) -> None:
        """Publish a message with a stamp [ns] and numbers, if it is subscribed to."""
        if self._readers():
            self.publish(self.write(stamp, *numbers))


def _set_numbers(message: Any, value: float) -> None:
    for field in message.get_fields_and_field_types():
        part = getattr(message, field)
        if isinstance(part, float):
            setattr(message, field, value)
        elif isinstance(part, array):
            setattr(message, field, array('d', [value] * len(part)))
        elif hasattr(part, 'get_fields_and_field_types'):
            _set_numbers(part, value)
