"""
Many messages in one, on their way from a node to the recorder.

A message costs whoever sends and whoever takes it more than its bytes do: a dozen topics at the
control rate take a fifth of a processor from the nodes that control. A batch says the names of the
topics, then of each message its topic, number and time of publication, and its bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import struct
import time
from typing import NamedTuple

from multicontact_control.errors import MessageError

# A std_msgs/UInt8MultiArray: encapsulation, no dimensions, offset 0, and the number of its bytes.
ENVELOPE = struct.Struct('<4sIII')
LITTLE_ENDIAN = b'\0\1\0\0'
NAMES = struct.Struct('<I')  # bytes of the names
FRAME = struct.Struct('<HIqI')  # topic, number, time [ns], bytes
LARGEST = 48 * 1024  # B, from which a batch is sent at once


class Entry(NamedTuple):
    """One message of a batch: topic, its number there, time of publication [ns], bytes."""

    topic_name: str
    sequence: int
    sent: int
    data: bytes


class RecordingBatch:
    """
    Messages of some topics that wait to be sent together.

    Parameters
    ----------
    topic_names
        Full names of the topics, in the order by which messages refer to them.

    """

    def __init__(self, topic_names: Sequence[str]) -> None:
        names = '\n'.join(topic_names).encode()
        self._head = NAMES.pack(len(names)) + names
        self._sequences = [0] * len(topic_names)
        self._parts: list[bytes] = []
        self._size = 0

    def add(self, topic: int, data: bytes) -> bool:
        """Add a message of a topic; return whether there are so many that they should be sent."""
        self._sequences[topic] += 1
        self._parts += (
            FRAME.pack(topic, self._sequences[topic], time.time_ns(), len(data)), data)
        self._size += len(data)
        return self._size > LARGEST

    def take(self) -> bytes:
        """Return what waits as a message, empty if nothing does."""
        if not self._parts:
            return b''
        content = b''.join((self._head, *self._parts))
        self._parts.clear()
        self._size = 0
        return ENVELOPE.pack(LITTLE_ENDIAN, 0, 0, len(content)) + content


def read_batch(data: bytes) -> Iterator[Entry]:
    """
    Yield the messages of a batch.

    Raises
    ------
    MessageError
        If it is none, or is cut off.

    """
    try:
        encapsulation, dimensions, offset, size = ENVELOPE.unpack_from(data)
        place = ENVELOPE.size
        if (encapsulation[:2], dimensions, offset) != (LITTLE_ENDIAN[:2], 0, 0) or (
                place + size > len(data)):
            raise MessageError('batch', 'whole', f'{len(data)} bytes')
        length, = NAMES.unpack_from(data, place)
        end, place = place + size, place + NAMES.size
        names = data[place:place + length].decode().split('\n')
        place += length
        while place < end:
            topic, sequence, sent, size = FRAME.unpack_from(data, place)
            place += FRAME.size
            if place + size > end:
                raise MessageError('batch', 'whole', f'{len(data)} bytes')
            yield Entry(names[topic], sequence, sent, data[place:place + size])
            place += size
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise MessageError('batch', 'topics and messages', error) from None
