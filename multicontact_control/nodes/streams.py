"""The ends of the topics of a node at the control rate: raw, and sent only where wanted."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any, NamedTuple

from multicontact_control.arrays import Vector
from multicontact_control.nodes.graph_node import (
    all_are_heard,
    create_publisher,
    create_subscription,
    served_profile,
)
from multicontact_control.nodes.raw_messages import MessageTemplate
from multicontact_control.nodes.topics import Topic
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

MEETING_PERIOD = 100_000_000  # ns, between two looks at publishers that are not heard


class _Output(NamedTuple):
    """One topic that is published."""

    publisher: Publisher
    template: MessageTemplate


class Streams:
    """
    What a node publishes and subscribes to at the control rate, as bytes.

    A message is made only if it is subscribed to.

    Parameters
    ----------
    node
        The node.

    Attributes
    ----------
    publishers, subscriptions
        The ends of the topics.

    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.publishers: dict[Topic, Publisher] = {}
        self.subscriptions: dict[Topic, Subscription] = {}
        self._outputs: dict[Topic, _Output] = {}
        self._next_meeting = 0
        self._adaptive: dict[Topic, QoSProfile] = {}
        self._callbacks: dict[Topic, Callable[[bytes], None]] = {}

    def subscribe(
        self, topic: Topic, callback: Callable[[bytes], None], profile: QoSProfile, *,
        adapt: bool = False,
    ) -> None:
        """Call back with every message; `adapt` to publishers that give less than `profile`."""
        if adapt:
            profile = self._adaptive[topic] = self._served(topic, profile)
        self._callbacks[topic] = callback
        self.subscriptions[topic] = self._create(topic, profile)

    def _create(self, topic: Topic, profile: QoSProfile) -> Subscription:
        return create_subscription(
            self._node, topic, self._callbacks[topic], profile, raw=True,
            strict=topic not in self._adaptive)

    def _served(self, topic: Topic, profile: QoSProfile) -> QoSProfile:
        """Return how a topic can be heard; see `served_profile`."""
        served = served_profile(self._node, self._node.resolve_topic_name(topic.name), profile)
        if served is not profile:
            self._node.get_logger().info(
                f'{topic.name}: subscribed best effort, as it is published')
        return served

    def meet_publishers(self) -> None:
        """Ask for less on topics with a publisher that is not heard, if it gives less."""
        now = time.monotonic_ns()
        if now < self._next_meeting:
            return
        self._next_meeting = now + MEETING_PERIOD
        for topic, profile in self._adaptive.items():
            end = self.subscriptions[topic]
            if all_are_heard(self._node, end):
                continue
            served = self._served(topic, profile)
            if served is not profile:
                self._node.destroy_subscription(end)
                self._adaptive[topic] = served
                self.subscriptions[topic] = self._create(topic, served)

    def advertise(self, patterns: dict[Topic, Any]) -> None:
        """Publish topics, with messages that are like these patterns but for stamp and numbers."""
        for topic, pattern in patterns.items():
            publisher = create_publisher(self._node, topic)
            self._outputs[topic] = _Output(publisher, MessageTemplate(pattern))
            self.publishers[topic] = publisher

    def wants(self, topic: Topic) -> bool:
        """Return whether a message of a topic would be received."""
        return bool(self._outputs[topic].publisher.get_subscription_count() > 0)

    def send(self, topic: Topic, stamp: int, *runs: Vector) -> None:
        """
        Publish a message on an advertised topic, if it is subscribed to.

        Parameters are its stamp [ns], and its numbers in the order of the message's fields.
        MessageError if one is not finite.
        """
        if self.wants(topic):
            self.pass_on(topic, self.message(topic, stamp, *runs))

    def message(self, topic: Topic, stamp: int, *runs: Vector) -> bytes:
        """Return what `send` would publish."""
        return self._outputs[topic].template.write(stamp, *runs)

    def pass_on(self, topic: Topic, data: bytes) -> None:
        """Publish bytes on a topic."""
        self._outputs[topic].publisher.publish(data)

    def close(self) -> None:
        """Free the topics."""
        for publisher in self.publishers.values():
            self._node.destroy_publisher(publisher)
        for subscription in self.subscriptions.values():
            self._node.destroy_subscription(subscription)
        self.publishers, self.subscriptions, self._outputs = {}, {}, {}
        self._adaptive, self._callbacks = {}, {}
