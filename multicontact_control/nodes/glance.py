"""
Listening to a running graph without making it send anything more.

Nodes hand what they send at the control rate to the recorder in batches, fifty times a second, and
nothing singly that nobody else subscribes to. Whoever wants no more than the newest values takes
them from there; only of nodes that send no batches are the topics themselves subscribed to.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from multicontact_control.nodes.graph_node import take
from multicontact_control.nodes.link import ControllerLink
from multicontact_control.nodes.recording_batch import read_batch
from multicontact_control.nodes.topics import batched_by, batches_of, Topic
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription


class GlancingLink(ControllerLink):
    """
    A connection to a running controller whose `newest` is up to 20 ms old.

    Parameters
    ----------
    topics, queued
        What to listen to; as for `ControllerLink`.
    namespace, domain_id, timeout
        As for `ControllerLink`.

    """

    def __init__(
        self, topics: Sequence[Topic], *, queued: Sequence[Topic] = (), namespace: str,
        domain_id: int | None, timeout: float,
    ) -> None:
        batched = [topic for topic in topics if topic in batched_by(topic.publisher)]
        super().__init__([topic for topic in topics if topic not in batched], queued=queued,
                         namespace=namespace, domain_id=domain_id, timeout=timeout)
        self._batched = {self.node.resolve_topic_name(topic.name): topic for topic in batched}
        self._batches: dict[str, Subscription] = {
            name: self._listen(batches_of(name), raw=True)
            for name in sorted({topic.publisher for topic in batched})}
        self._unread: dict[Topic, bytes] = {}

    def newest(self, topic: Topic) -> Any | None:
        """
        Return the newest message of a topic, None if none has come so far.

        Raises
        ------
        MessageError
            If a batch cannot be read.

        """
        batches = self._batches.get(topic.publisher)
        if batches is not None:
            self._unpack(topic.publisher, batches)
            if topic in self._unread:
                self._newest[topic] = deserialize_message(
                    self._unread.pop(topic), topic.message)
            elif topic not in self._subscriptions and not batches.get_publisher_count():
                self._subscriptions[topic] = self._listen(topic)
        return super().newest(topic) if topic in self._subscriptions else (
            self._newest.get(topic))

    def _unpack(self, publisher: str, batches: Subscription) -> None:
        """Take the newest messages out of a node's batches; it need not send them singly then."""
        while (taken := take(batches)) is not None:
            for entry in read_batch(taken[0]):
                topic = self._batched.get(entry.topic_name)
                if topic is not None:
                    self._unread[topic] = entry.data
                    if topic in self._subscriptions:
                        self.node.destroy_subscription(self._subscriptions.pop(topic))
