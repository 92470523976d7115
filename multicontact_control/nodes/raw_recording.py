"""
Recording topics without decoding them and without an executor.

The subscriptions are emptied by whoever records, many times a second. The middleware stores what
arrives meanwhile, with the time of its arrival; so a recorder takes next to no time from the nodes
it shares the machine with, and learns the number of each message in its publisher's stream, which
tells how many are missing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
import time
from typing import Any

from multicontact_control.nodes.bag_writer import BagWriter
from multicontact_control.nodes.graph_node import ignore, take
from multicontact_control.nodes.loop_statistics import Freshness
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

FLUSH_PERIOD = 0.5  # s


@dataclass
class Stream:
    """
    One topic being recorded.

    Attributes
    ----------
    name
        Full name.
    subscription
        Where its bytes come from.
    judged
        Whether missing numbers are counted; not where several may publish, since their numbers
        cannot be told apart.
    on_message
        Called with bytes, log time and publish time [ns] of what has been written.

    """

    name: str
    subscription: Subscription
    judged: bool = True
    on_message: Callable[[bytes, int, int], None] | None = None
    last_sequence: int = 0
    lost: int = 0
    before_start: int = 0

    def count(self, sequence: int | None) -> None:
        """
        Take note of a message's number in its stream; what is skipped was lost.

        A number that falls back is a new publisher's. What was sent before the first number was
        not for the recorder, which may have come late.
        """
        if sequence is None or not self.judged:
            return
        if self.last_sequence == 0:
            self.before_start = sequence - 1
        elif sequence > self.last_sequence:
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

    """

    def __init__(self, node: Node, writer: BagWriter) -> None:
        self._node = node
        self._writer = writer
        self._next_flush = 0.0
        self.streams: dict[str, Stream] = {}
        self.fresh = Freshness()

    def add(
        self, name: str, message: Any, type_name: str, *, offered: QoSProfile,
        requested: QoSProfile, judged: bool = True,
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
            Quality of service of its publishers, for the metadata, and of the subscription.
        judged
            Whether to count what is missing.

        Raises
        ------
        RunError
            If the type is not installed.

        """
        full = self._node.resolve_topic_name(name)
        self._writer.add_topic(full, type_name, offered)
        # The callback is never called, since no executor has the node.
        subscription = self._node.create_subscription(
            message, name, ignore, requested, raw=True)
        self.streams[full] = Stream(full, subscription, judged)
        return self.streams[full]

    def drain(self) -> int:
        """Write what has arrived, in the order of arrival; return how many messages that was."""
        messages = []
        for stream in self.streams.values():
            while (taken := take(stream.subscription)) is not None:
                data, info = taken
                sequence = info['publication_sequence_number']
                stream.count(sequence)
                if stream.judged:
                    self.fresh.note(stream.name)
                received = info['received_timestamp'] or time.time_ns()
                sent = info['source_timestamp'] or received
                messages.append((received, sent, (sequence or 0) & 0xFFFFFFFF, data, stream))
        messages.sort(key=itemgetter(0))
        for received, sent, sequence, data, stream in messages:
            self._writer.write(stream.name, data, received, sent, sequence)
            if stream.on_message is not None:
                stream.on_message(data, received, sent)
        if time.monotonic() >= self._next_flush:
            self._writer.flush()
            self._next_flush = time.monotonic() + FLUSH_PERIOD
        return len(messages)

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
