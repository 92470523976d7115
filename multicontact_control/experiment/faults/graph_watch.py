"""Listening to a graph while faults happen in it: everything that is said, with its time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from multicontact_control.nodes import messages, qos, topics
from rclpy.node import Node
from rclpy.subscription import Subscription

CHECKED = (topics.EFFORT_COMMAND, topics.DESIRED_FORCES, topics.ESTIMATED_FORCES,
           topics.NOISE_VARIANCE, topics.TRUE_FORCES)
REMEMBERED = 30_000  # messages per topic: a minute at 500 Hz


@dataclass(frozen=True, slots=True)
class ReceivedMessage:
    """
    One named list of numbers as it was published.

    Attributes
    ----------
    time
        When it was sent, on the wall clock [s].
    stamp
        Of the sample it belongs to [ns].
    values
        Efforts by name, in the order of the message.

    """

    time: float
    stamp: int
    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class Report:
    """Diagnostics of one node as they came: when [s], and by part level, message and values."""

    time: float
    node: str
    parts: dict[str, tuple[int, str, dict[str, str]]]


class GraphWatch:
    """
    Keeps what comes on some topics; nothing happens in between calls of `poll`.

    Parameters
    ----------
    node
        The node that subscribes; no executor may have it.

    """

    def __init__(self, node: Node) -> None:
        self._streams: dict[topics.Topic, Subscription] = {
            topic: node.create_subscription(topic.message, topic.name, _ignore, qos.RECORDING)
            for topic in (*CHECKED, topics.POSE_DESIRED)}
        self._diagnostics = node.create_subscription(
            topics.DIAGNOSTICS.message, topics.DIAGNOSTICS.name, _ignore, qos.RECORDING)
        self.said: dict[topics.Topic, deque[ReceivedMessage]] = {
            topic: deque(maxlen=REMEMBERED) for topic in CHECKED}
        self.reports: deque[Report] = deque(maxlen=1000)
        self.pose: Any = None
        self.polled = math.inf  # everything that was sent until then has been looked for

    def poll(self) -> None:
        """Take in what has come."""
        self.polled = time.time()
        for topic, subscription in self._streams.items():
            for message, sent in _taken(subscription, topic.message):
                if topic is topics.POSE_DESIRED:
                    self.pose = message
                else:
                    self.said[topic].append(ReceivedMessage(
                        sent, messages.stamp_to_ns(message.header.stamp),
                        dict(zip(message.name, message.effort))))
        for message, sent in _taken(self._diagnostics, topics.DIAGNOSTICS.message):
            if message.status:
                self.reports.append(_report(message, sent))

    def since(self, topic: topics.Topic, start: float) -> list[ReceivedMessage]:
        """Return what was sent on a topic from a time on."""
        found = []
        for said in reversed(self.said[topic]):
            if said.time < start:
                break
            found.append(said)
        return found[::-1]

    def newest(self, topic: topics.Topic) -> ReceivedMessage | None:
        """Return what came last on a topic."""
        said = self.said[topic]
        return said[-1] if said else None

    def reports_since(self, start: float) -> Iterable[Report]:
        """Return the diagnostics since a time."""
        return (report for report in self.reports if report.time >= start)


def _report(message: Any, sent: float) -> Report:
    status: DiagnosticStatus
    parts = {}
    node = ''
    for status in message.status:
        node, _, part = status.name.partition(': ')
        level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
        parts[part] = (level, status.message, {x.key: x.value for x in status.values})
    return Report(sent, node.rsplit('/', 1)[-1], parts)


def _taken(subscription: Subscription, message: Any) -> Iterable[tuple[Any, float]]:
    """Yield what has arrived, with the time when it was sent [s]."""
    handle = subscription.handle
    with handle:
        while (taken := handle.take_message(message, False)) is not None:
            found, info = taken
            yield found, (info['source_timestamp'] or time.time_ns()) * 1e-9


def finite(said: ReceivedMessage) -> bool:
    """Return whether all numbers are."""
    return all(map(math.isfinite, said.values.values()))


def _ignore(_message: Any) -> None:
    pass
