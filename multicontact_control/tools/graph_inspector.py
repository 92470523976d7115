"""A node that looks at a graph without taking part in it."""

from __future__ import annotations

import os
import time

from multicontact_control.errors import RunError
from multicontact_control.nodes import qos
from multicontact_control.nodes.graph_node import full_topic_name
from multicontact_control.nodes.link import GuestNode
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

DISCOVERY_POLL = 0.02
POLL_PERIOD = 0.005


class GraphInspector(GuestNode):
    """A hidden node; to be used in a with statement."""

    def __init__(self, domain_id: int | None = None) -> None:
        super().__init__(f'_multicontact_{os.getpid()}', domain_id)

    def topics(self) -> dict[str, list[str]]:
        """Return the types by topic, of those that are not hidden and that someone publishes."""
        return {
            name: types for name, types in sorted(self.node.get_topic_names_and_types())
            if not any(part.startswith('_') for part in name.split('/'))}

    def publishers(self, name: str) -> list[TopicEndpointInfo]:
        """Return what is known of the publishers of a topic."""
        return list(self.node.get_publishers_info_by_topic(name))

    def wait_for_publisher(self, name: str, timeout: float, stop: object = False) -> None:
        """
        Wait until a topic is published, `timeout` [s] at most, or until `stop` is true.

        Raises
        ------
        RunError
            If it is not, naming the topics there are.

        """
        give_up = time.monotonic() + timeout
        while not (self.publishers(name) or stop):
            if time.monotonic() > give_up:
                known = ', '.join(self.topics()) or 'none; is ROS_DOMAIN_ID that of the graph?'
                raise RunError(f'{name}: expected a publisher within {timeout:g} s, found none '
                               f'(topics: {known})')
            time.sleep(DISCOVERY_POLL)


def full_name(topic: str) -> str:
    """Return the name of a topic with its leading slash; ConfigError if ROS accepts none such."""
    return full_topic_name('topic', '/' + topic.strip('/'))


def matching_profile(publishers: list[TopicEndpointInfo], depth: int) -> QoSProfile:
    """Return the best quality of service that all publishers of a topic can give."""
    offered = [info.qos_profile for info in publishers]
    reliable = all(x.reliability == ReliabilityPolicy.RELIABLE for x in offered)
    latched = all(x.durability == DurabilityPolicy.TRANSIENT_LOCAL for x in offered)
    return qos.profile(depth, reliable=reliable, latched=latched)
