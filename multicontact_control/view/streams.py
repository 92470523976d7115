"""Every message of a topic, so that curves have the extremes between two of their points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.nodes import qos
from multicontact_control.nodes.graph import ignore_message, take_message
from multicontact_control.nodes.messages import read_named_vectors
from multicontact_control.nodes.streams import MessageReader
from multicontact_control.nodes.topics import Topic
import numpy as np
from rclpy.node import Node

# Best effort: a page that is late by a command it gives must not make a sender wait.
CURVE_QOS = qos.make_profile(5000, reliable=False)
MESSAGES_AT_ONCE = 500  # so that a graph that is faster than the page cannot keep it


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
        block = self._convert(np.array(self._block or [self.newest]))
        self._block.clear()
        return np.fmin.reduce(block), np.fmax.reduce(block)
