"""
Messages of the control rate as bytes: read in place, written into prepared ones.

All messages of a stream have the same bytes but for their stamp and their numbers, as long as
names and lengths stay. Bytes are CDR (XCDR version 1) with its encapsulation header.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import struct
from typing import Any, Generic, NamedTuple, TypeVar

from geometry_msgs.msg import WrenchStamped
from multicontact_control.arrays import Vector
from multicontact_control.errors import counted, MessageError
from multicontact_control.force.noise import Innovation
from multicontact_control.nodes.graph_node import create_publisher
from multicontact_control.nodes.loop_statistics import NANOSECONDS
from multicontact_control.nodes.messages import all_finite, finite, split_stamp, stamp_to_ns
from multicontact_control.nodes.topics import Topic
from multicontact_control.sampling import JointReading, WrenchReading
import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

HEADER = 4  # bytes of the encapsulation: representation, options
STAMP = struct.Struct('<iI')
JOINT_FIELDS = ('position', 'velocity', 'effort')

Reading = TypeVar('Reading')


class NamedReading(NamedTuple):
    """One number per name at a time [ns], in the order that was asked for."""

    stamp: int
    values: Vector


class InnovationReading(NamedTuple):
    """What the observers found at a time [ns], in the order that was asked for."""

    stamp: int
    innovation: Innovation


class MessageTemplate:
    """
    A message whose stamp and numbers are read and written where they stand in its bytes.

    It is a time, or a header and then names and numbers; `runs` are slices of its numbers, of
    each list, or of all where there are none.
    """

    def __init__(self, message: Any) -> None:
        constants, runs, size = _lay_out(message)
        # From the first number on all are at multiples of 8 bytes from each other, so that one
        # array covers them; what is between two runs is a length and means nothing as a number.
        filled = [start for start, count in runs if count]
        self._first = filled[0] if filled else size
        self._covered = (size - self._first) // 8
        self.runs = [slice((start - self._first) // 8, (start - self._first) // 8 + count)
                     for start, count in runs]
        data, text, at = serialize_message(message), '<', 0
        self._bytes = bytearray(size)  # padding is 0
        for start, end in constants:
            self._bytes[start:end] = data[start:end]
            text += f'{start - at}x{end - start}s'
            at = end
        self._constants = struct.Struct(text)
        self._expected = self._constants.unpack_from(self._bytes)
        self._numbers = np.frombuffer(self._bytes, '<f8', self._covered, self._first) if (
            filled) else np.zeros(0)
        self._views = [self._numbers[run] for run in self.runs if run.stop > run.start]

    def read(self, data: bytes) -> tuple[int, Vector] | None:
        """
        Return stamp [ns] and numbers of a message, of which `runs` are slices.

        None if anything but these differs from the template's, or the stamp is none. What follows
        the message in its bytes means nothing, to rclpy as well.
        """
        if len(data) < len(self._bytes) or self._constants.unpack_from(data) != self._expected:
            return None
        sec, nanosec = STAMP.unpack_from(data, HEADER)
        if nanosec >= NANOSECONDS:
            return None
        # A copy: bytes need not begin at a multiple of 8 in memory, which numba asks for.
        numbers = np.frombuffer(data, '<f8', self._covered, self._first).copy()
        return sec * NANOSECONDS + nanosec, numbers

    def write(self, stamp: int, *runs: Vector) -> bytes:
        """Return the message with another stamp [ns], and other numbers in its runs."""
        sec, nanosec = split_stamp(stamp)
        for view, values in zip(self._views, runs):
            view[:] = values
        finite(self._numbers, 'numbers')
        STAMP.pack_into(self._bytes, HEADER, sec, nanosec)
        return bytes(self._bytes)


def _lay_out(message: Any) -> tuple[list[tuple[int, int]], list[tuple[int, int]], int]:
    """
    Return where a message stands in its bytes.

    First and last byte, exclusive, of strings and lengths; first byte and count of runs of
    doubles; and the size. Alignment counts from the end of the encapsulation.
    """
    constants, runs, at = [(0, 2)], [], HEADER + STAMP.size

    def add(size: int) -> None:
        nonlocal at
        start = at + -at % 4
        at = start + size
        constants.append((start, at))

    def add_run(count: int) -> None:
        nonlocal at
        at += (HEADER - at) % 8 if count else 0
        runs.append((at, count))
        at += 8 * count

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
    return constants, runs, at


class MessageReader(Generic[Reading]):
    """
    Reads the messages of one topic from their bytes.

    Frame, names and lengths are checked by way of the message class, again when they change
    (`slow` counts that); stamp and numbers are taken from where they stand.

    Parameters
    ----------
    class_
        Of the topic.
    arrange
        Returns where the vectors of a reading are among the numbers of a message, from it and
        the runs of its template; raises `MessageError` if it cannot be used.
    make
        Makes the reading of a stamp and these vectors, or raises `MessageError`.

    """

    def __init__(
        self, class_: Any, arrange: Callable[[Any, list[slice]], Sequence[Any]],
        make: Callable[..., Reading],
    ) -> None:
        self._class, self._arrange, self._make = class_, arrange, make
        self._template: MessageTemplate | None = None
        self._places: Sequence[Any] = ()
        self.slow = 0

    def read(self, data: bytes) -> Reading:
        """Return the reading in a message; MessageError if it is none, or cannot be used."""
        found = self._template.read(data) if self._template is not None else None
        stamp, numbers = found or self._learn(data)
        return self._make(stamp, *[numbers[place] for place in self._places])

    def _learn(self, data: bytes) -> tuple[int, Vector]:
        """Check a message by way of its class, and take its layout for that of the next."""
        self.slow += 1
        try:
            message = deserialize_message(data, self._class)
        except Exception as error:  # of whatever kind the middleware raises
            raise MessageError('data', f'a {self._class.__name__}', error) from None
        stamp = stamp_to_ns(message.header.stamp)
        template = MessageTemplate(message)
        self._places = self._arrange(message, template.runs)
        self._template = template
        # Written anew: it may have come in another representation.
        found = template.read(serialize_message(message))
        return found or (stamp, np.zeros(0))


def joint_state_reader(names: Sequence[str]) -> MessageReader[JointReading]:
    """
    Return a reader of positions and velocities of joints, which may be among others.

    The effort is read where there is one for every joint: not every robot measures it.
    """
    def make(stamp: int, q: Vector, qd: Vector, effort: Vector | None = None) -> JointReading:
        return JointReading(
            stamp, finite(q, 'position'), finite(qd, 'velocity'),
            effort if effort is not None and all_finite(effort) else None)

    def arrange(message: JointState, runs: list[slice]) -> Sequence[Any]:
        with_effort = len(message.effort) == len(message.name)
        return _places(message, names, JOINT_FIELDS if with_effort else JOINT_FIELDS[:2], runs)

    return MessageReader(JointState, arrange, make)


def effort_reader(names: Sequence[str]) -> MessageReader[NamedReading]:
    """Return a reader of one effort per name: torques [N m], forces [N] or variances [N^2]."""
    return MessageReader(
        JointState, lambda message, runs: _places(message, names, ('effort',), runs),
        lambda stamp, values: NamedReading(stamp, finite(values, 'effort')))


def innovation_reader(names: Sequence[str]) -> MessageReader[InnovationReading]:
    """Return a reader of effort r [N], velocity C P_1 C^T and position R used [N^2] per name."""
    def make(stamp: int, used: Vector, prior: Vector, innovation: Vector) -> InnovationReading:
        return InnovationReading(stamp, Innovation(
            innovation=finite(innovation, 'effort'), prior_variance=finite(prior, 'velocity'),
            variance_used=finite(used, 'position')))

    return MessageReader(
        JointState, lambda message, runs: _places(message, names, JOINT_FIELDS, runs), make)


def wrench_reader(
    frame: str = '', on_nameless: Callable[[], object] = lambda: None,
) -> MessageReader[WrenchReading]:
    """
    Return a reader of wrenches, force first, in a frame; empty for any.

    A message that names no frame is taken for it; `on_nameless` is called when these begin.
    """
    def arrange(message: WrenchStamped, runs: list[slice]) -> Sequence[Any]:
        found = message.header.frame_id.lstrip('/')
        if frame and found and found != frame:
            raise MessageError('header.frame_id', f"'{frame}' (robot.sensor_frame), or none",
                               f"'{found}'")
        if frame and not found:
            on_nameless()
        return runs

    return MessageReader(WrenchStamped, arrange, lambda stamp, wrench: WrenchReading(
        stamp, finite(wrench, 'wrench')))


def _places(
    message: JointState, names: Sequence[str], fields: Sequence[str], runs: list[slice],
) -> list[Any]:
    """Return where the numbers of these names are, for each field."""
    found = list(message.name)
    if any(found.count(name) != 1 for name in names):
        raise MessageError('name', f'each of {list(names)} once', found)
    places = [found.index(name) for name in names]
    for field in fields:
        if len(getattr(message, field)) != len(found):
            raise MessageError(
                field, counted(len(found), 'values'), f'{len(getattr(message, field))}')
    chosen = [runs[JOINT_FIELDS.index(field)] for field in fields]
    if places == list(range(len(found))):
        return chosen
    return [run.start + np.array(places, dtype=int) for run in chosen]


class Streams:
    """The `publishers` and `subscriptions` of a node at the control rate, for bytes."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.publishers: dict[Topic, Publisher] = {}
        self.subscriptions: dict[Topic, Subscription] = {}
        self._templates: dict[Topic, MessageTemplate] = {}

    def subscribe(
        self, topic: Topic, callback: Callable[[bytes], None], profile: QoSProfile,
    ) -> None:
        """Call back with every message of a topic."""
        self.subscriptions[topic] = self._node.create_subscription(
            topic.message, topic.name, callback, profile, raw=True)

    def advertise(self, patterns: dict[Topic, Any]) -> None:
        """Publish topics, with messages that are like these patterns but for stamp and numbers."""
        for topic, pattern in patterns.items():
            self.publishers[topic] = create_publisher(self._node, topic)
            self._templates[topic] = MessageTemplate(pattern)

    def send(self, topic: Topic, stamp: int, *runs: Vector) -> None:
        """Publish a message of a stamp [ns] and numbers in its order, if it is subscribed to."""
        if self.publishers[topic].get_subscription_count():
            self.pass_on(topic, self.message(topic, stamp, *runs))

    def message(self, topic: Topic, stamp: int, *runs: Vector) -> bytes:
        """Return what `send` would publish."""
        return self._templates[topic].write(stamp, *runs)

    def pass_on(self, topic: Topic, data: bytes) -> None:
        """Publish bytes on a topic."""
        self.publishers[topic].publish(data)

    def close(self) -> None:
        """Free the topics."""
        for publisher in self.publishers.values():
            self._node.destroy_publisher(publisher)
        for subscription in self.subscriptions.values():
            self._node.destroy_subscription(subscription)
        self.publishers, self.subscriptions, self._templates = {}, {}, {}
