"""Every sample of a graph that runs, so that its curves have the extremes between two points."""

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

# A page may be late by a command that it gives. It may not make a sender wait.
KEPT = qos.make_profile(5000, reliable=False)
MOST = 500  # messages that are taken at once, of a graph that is faster than the page


class Stream:
    """
    The efforts of every message of one topic.

    Parameters
    ----------
    node
        Subscribes.
    names
        Those whose efforts are read, shape (k,).
    convert
        Makes what is shown of efforts of shape (m, k).

    Attributes
    ----------
    newest
        What the last message has, shape (k,); NaN for names that it lacks, or without any message.

    """

    def __init__(
        self,
        node: Node,
        topic: Topic,
        names: Sequence[str],
        convert: Callable[[Matrix], Matrix] = np.asarray,
    ) -> None:
        self._names, self._convert = names, convert
        self._known: list[int] = []  # places of the names that messages have
        self._read = MessageReader(topic.message, self._read_object)
        self._subscription = node.create_subscription(
            topic.message, topic.name, ignore_message, KEPT, raw=True
        )
        self.newest: Vector = np.full(len(names), np.nan)
        self._block: list[Vector] = []

    def _read_object(self, message: Any) -> tuple[Any, ...]:
        self._known = [k for k, name in enumerate(self._names) if name in message.name]
        return read_named_vectors(
            message, [self._names[k] for k in self._known], (), unchecked=('effort',)
        )

    def look(self) -> None:
        """Take what has come since the last look."""
        for _ in range(MOST):
            taken = take_message(self._subscription)
            if taken is None:
                break
            _, efforts = self._read(bytes(taken[0]))
            if efforts is not None:
                self.newest = np.full(len(self._names), np.nan)
                self.newest[self._known] = efforts
                self._block.append(self.newest)

    def extremes(self) -> tuple[Vector, Vector]:
        """Return the least and the greatest since this was called last, or what was there then."""
        block = self._convert(np.array(self._block or [self.newest]))
        self._block.clear()
        return np.fmin.reduce(block), np.fmax.reduce(block)
