"""Every message of a graph's topics, so that curves have the extremes between two points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.nodes import qos, topics
from multicontact_control.nodes.graph import ignore_message, take_message
from multicontact_control.nodes.messages import read_named_vectors
from multicontact_control.nodes.streams import MessageReader
from multicontact_control.nodes.topics import Topic
from multicontact_control.view.source import (
    BLOCKS,
    count_point_columns,
    find_torque_limits,
    RATE,
)
import numpy as np
from rclpy.node import Node

# Best effort: a page that is late by a command it gives must not make a sender wait.
CURVE_QOS = qos.make_profile(5000, reliable=False)
MESSAGES_AT_ONCE = 500  # so that a graph that is faster than the page cannot keep it
BLOCK_TIME = 1.0 / (BLOCKS * RATE)  # s, from one block of samples to the next
# Topics of forces, in the order of `Snapshot.points`; the torques follow.
FORCE_TOPICS = (
    topics.MEASURED_FORCES,
    topics.ESTIMATED_FORCES,
    topics.DESIRED_FORCES,
    topics.TRUE_FORCES,
    topics.NOISE_VARIANCE,
    topics.INNOVATION,
)


class EffortStream:
    """
    The efforts in every message of one topic, of forces by contact or torques by joint.

    Parameters
    ----------
    node
        Node that subscribes to the topic.
    topic
        Topic whose messages have names and efforts.
    names
        The k names whose efforts are read, in this order.
    convert
        Function from efforts, shape (m, k), to the values that are drawn, same shape.

    Attributes
    ----------
    newest
        Efforts of the last message, shape (k,); NaN for names that it lacks, and for all of
        them before the first message.

    """

    def __init__(
        self,
        node: Node,
        topic: Topic,
        names: Sequence[str],
        convert: Callable[[Matrix], Matrix] = np.asarray,
    ) -> None:
        self._names = names
        self._convert = convert
        self._present: list[int] = []  # indices of the names that the messages have
        self._read = MessageReader(topic.message, self._read_efforts)
        self._subscription = node.create_subscription(
            topic.message, topic.name, ignore_message, CURVE_QOS, raw=True
        )
        self.newest: Vector = np.full(len(names), np.nan)
        self._block: list[Vector] = []

    def _read_efforts(self, message: Any) -> tuple[Any, ...]:
        self._present = [
            k for k, name in enumerate(self._names) if name in message.name
        ]
        names = [self._names[k] for k in self._present]
        return read_named_vectors(message, names, (), unchecked=('effort',))

    def take_messages(self) -> None:
        """
        Take the messages that have come since the last call, at most `MESSAGES_AT_ONCE`.

        The last becomes `newest`, and all of them count for the next `take_extremes`.
        """
        for _ in range(MESSAGES_AT_ONCE):
            taken = take_message(self._subscription)
            if taken is None:
                break
            _, efforts = self._read(bytes(taken[0]))
            if efforts is not None:
                self.newest = np.full(len(self._names), np.nan)
                self.newest[self._present] = efforts
                self._block.append(self.newest)

    def take_extremes(self) -> tuple[Vector, Vector]:
        """
        Return the least and the greatest values since the last call, each of shape (k,).

        Both are those of `newest` if no message has come since then; NaN is skipped where a
        message has a number.
        """
        efforts = self._block if self._block else [self.newest]
        block = self._convert(np.array(efforts))
        self._block.clear()
        return np.fmin.reduce(block), np.fmax.reduce(block)


class CurveStreams:
    """
    The streams of all curves of a graph, and the points of the curves since the last snapshot.

    Parameters
    ----------
    node
        Node that subscribes to the topics.
    config
        Configuration of the controller: its contacts, joints and torque limits.

    """

    def __init__(self, node: Node, config: ControllerConfig) -> None:
        joint_names = config.robot.joint_names
        limits = find_torque_limits(config)

        def relate_to_limit(torques: Matrix) -> Matrix:
            return np.abs(torques) / limits

        self._forces = {
            topic: EffortStream(node, topic, config.column_names)
            for topic in FORCE_TOPICS
        }
        torques = EffortStream(
            node, topics.EFFORT_COMMAND, joint_names, relate_to_limit
        )
        self._streams = [*self._forces.values(), torques]
        self._width = count_point_columns(config)
        self._points: list[Vector] = []
        self._drawn_until = 0.0  # time of the last point [s]

    def get_newest(self, topic: Topic) -> Vector:
        """Return the last efforts of one of `FORCE_TOPICS`, shape (r,); see `EffortStream`."""
        return self._forces[topic].newest

    def take_messages(self) -> None:
        """Take the messages of all streams that have come since the last call."""
        for stream in self._streams:
            stream.take_messages()

    def begin_anew(self) -> None:
        """Let the next block of samples begin before time zero, as samples begin there."""
        self._drawn_until = -BLOCK_TIME

    def add_points(self, time: float) -> None:
        """Add two points that end a block of samples at a time [s]: its least and greatest."""
        extremes = [stream.take_extremes() for stream in self._streams]
        least, greatest = zip(*extremes)
        middle = 0.5 * (self._drawn_until + time)
        self._points.append(np.concatenate([[middle], *least]))
        self._points.append(np.concatenate([[time], *greatest]))
        self._drawn_until = time

    def take_points(self) -> Matrix:
        """Return the points since the last call, shape (k, 1 + KINDS r + n); see `Snapshot`."""
        points = np.array(self._points).reshape(-1, self._width)
        self._points.clear()
        return points
