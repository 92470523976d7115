"""
Recording topics without decoding them and without an executor.

The subscriptions are emptied by whoever records, many times a second. The middleware stores what
arrives meanwhile, with the time of its arrival; so a recorder takes next to no time from the nodes
it shares the machine with, and learns the number of each message in its publisher's stream, which
tells how many are missing. Nodes of this package may hand over their messages in batches, each
with its number and the time of its publication; that time is then that of its arrival, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import itemgetter
import time
from typing import Any

from multicontact_control.errors import MessageError
from multicontact_control.nodes.bag_writer import BagWriter
from multicontact_control.nodes.graph_node import (
    all_are_heard,
    ignore,
    served_profile,
    take,
)
from multicontact_control.nodes.loop_statistics import Freshness
from multicontact_control.nodes.recording_batch import read_batch
from multicontact_control.nodes.topics import Topic
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

FLUSH_PERIOD = 0.5  # s

# Time of arrival and of publication [ns], number, bytes, topic.
Arrival = tuple[int, int, 'int | None', bytes, 'Stream']


@dataclass
class Stream:
    """
    One topic being recorded.

    Attributes
    ----------
    name
        Full name.
    subscription
        Where its bytes come from, None if they come in batches.
    judged
        Whether missing numbers are counted; not where several may publish, since their numbers
        cannot be told apart.
    on_message
        Called with bytes, log time and publish time [ns] of what has been written.

    """

    name: str
    subscription: Subscription | None
    judged: bool = True
    on_message: Callable[[bytes, int, int], None] | None = None
    last_sequence: int = 0
    lost: int = 0
    before_start: int = 0

    def count(self, sequence: int | None) -> None:
        """
        Take note of a message's number in its stream; what is skipped was lost.

        A number that falls back is a new publisher's; of several at once nothing can be told.
        What was sent before the first number was not for the recorder, which may have come late.
        """
        if sequence is None or not self.judged:
            return
        if self.last_sequence == 0:
            self.before_start = sequence - 1
        elif sequence > self.last_sequence + 1 and (
                self.subscription is None or self.subscription.get_publisher_count() < 2):
            self.lost += sequence - self.last_sequence - 1
        self.last_sequence = sequence


class RawRecording:
    """
    Topics on their way into a bag.

    Parameters
    ----------
    node
        The node that subscribes; no executor may have it.
    writer
        The bag.

    Attributes
    ----------
    streams
        The topics by full name.
    fresh
        When each of those that are judged last came.
    broken
        Batches that could not be read.

    """

    def __init__(self, node: Node, writer: BagWriter) -> None:
        self._node = node
        self._writer = writer
        self._next_flush = 0.0
        self._batches: list[Subscription] = []
        self.streams: dict[str, Stream] = {}
        self.broken = 0
        self.fresh = Freshness()

    def add(
        self, name: str, message: Any, type_name: str, *, offered: QoSProfile,
        requested: QoSProfile | None, judged: bool = True,
    ) -> Stream:
        """
        Start to record a topic.

        Parameters
        ----------
        name
            Name, relative or full.
        message, type_name
            Its class and its type as ROS tools write it.
        offered, requested
            Quality of service of its publishers, for the metadata, and of the subscription; None
            for a topic that comes in batches.
        judged
            Whether to count what is missing.

        Raises
        ------
        ConfigError
            If it is recorded already.
        RunError
            If the type is not installed.

        """
        full = self._node.resolve_topic_name(name)
        self._writer.add_topic(full, type_name, offered)
        subscription = None if requested is None else self._subscribe(message, name, requested)
        self.streams[full] = Stream(full, subscription, judged)
        return self.streams[full]

    def add_batches(self, topic: Topic, requested: QoSProfile) -> Subscription:
        """Take messages of topics that were added out of the batches of a node, too."""
        subscription = self._subscribe(topic.message, topic.name, requested)
        self._batches.append(subscription)
        return subscription

    def _subscribe(self, message: Any, name: str, requested: QoSProfile) -> Subscription:
        # The callback is never called, since no executor has the node.
        return self._node.create_subscription(message, name, ignore, requested, raw=True)

    def meet_publishers(self) -> None:
        """Ask for no more than is given where one of a topic's publishers gives less."""
        for stream in self.streams.values():
            end = stream.subscription
            if end is None or all_are_heard(self._node, end):
                continue
            profile = end.qos_profile
            served = served_profile(self._node, stream.name, profile)
            if served is not profile:
                self.drain()
                self._node.destroy_subscription(end)
                stream.subscription = self._subscribe(end.msg_type, stream.name, served)
                self._node.get_logger().info(f'{stream.name}: recorded best effort, as published')

    def drain(self) -> int:
        """Write what has arrived, in the order of arrival; return how many messages that was."""
        messages = [*self._taken(), *self._unpacked()]
        messages.sort(key=itemgetter(0))
        for received, sent, sequence, data, stream in messages:
            stream.count(sequence)
            if stream.judged:
                self.fresh.note(stream.name)
            self._writer.write(stream.name, data, received, sent, (sequence or 0) & 0xFFFFFFFF)
            if stream.on_message is not None:
                stream.on_message(data, received, sent)
        if time.monotonic() >= self._next_flush:
            self._writer.flush()
            self._next_flush = time.monotonic() + FLUSH_PERIOD
        return len(messages)

    def _taken(self) -> Iterator[Arrival]:
        """Yield what has come on the topics themselves."""
        for stream in self.streams.values():
            while stream.subscription is not None and (
                    taken := take(stream.subscription)) is not None:
                data, info = taken
                received = info['received_timestamp'] or time.time_ns()
                sent = info['source_timestamp'] or received
                yield received, sent, info['publication_sequence_number'], data, stream

    def _unpacked(self) -> Iterator[Arrival]:
        """Yield what has come in batches; it was there when it was sent, at the latest."""
        for subscription in self._batches:
            while (taken := take(subscription)) is not None:
                try:
                    for entry in read_batch(taken[0]):
                        stream = self.streams.get(entry.topic_name)
                        if stream is not None:
                            yield entry.sent, entry.sent, entry.sequence, entry.data, stream
                except MessageError:
                    self.broken += 1

    def drain_until_quiet(self, quiet_time: float, timeout: float, period: float) -> None:
        """
        Write what still comes.

        Parameters
        ----------
        quiet_time
            Time without a message after which nothing more is expected [s].
        timeout
            Longest wait for such a time [s].
        period
            Time between two looks [s].

        """
        give_up = time.monotonic() + timeout
        quiet_since = time.monotonic()
        while time.monotonic() < give_up:
            if self.drain():
                quiet_since = time.monotonic()
            if time.monotonic() - quiet_since >= quiet_time:
                break
            time.sleep(period)
