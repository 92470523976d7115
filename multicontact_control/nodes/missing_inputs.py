"""Names the topics that do not come, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping
import time

from multicontact_control.nodes.graph_node import quality_mismatches
from multicontact_control.nodes.loop_statistics import Freshness, NANOSECONDS
from multicontact_control.nodes.topics import SIM, Topic
from multicontact_control.wording import counted
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

PATIENCE = 1.0  # s without a message, from which on a topic is missing
REPEAT_TIME = 30 * NANOSECONDS  # ns


class MissingInputs:
    """
    Logs which inputs of a node do not come for a second.

    Parameters
    ----------
    node
        The node.
    fresh
        When each of them came last.
    inputs
        Quality of service that each must have at least, and what is expected in it.

    """

    def __init__(
        self, node: Node, fresh: Freshness, inputs: Mapping[Topic, tuple[QoSProfile, str]],
    ) -> None:
        self._node, self._fresh, self._inputs = node, fresh, inputs
        self._told: dict[Topic, int] = {}
        self.restart()

    def restart(self) -> None:
        """Wait for all of them from now on."""
        self._since = time.monotonic_ns()
        self._next = self._since + NANOSECONDS

    def poll(self) -> None:
        """Look once a second; costs next to nothing otherwise."""
        now = time.monotonic_ns()
        if now < self._next:
            return
        self._next = now + NANOSECONDS
        ages = self._fresh.ages()
        for topic in self._inputs:
            age = ages.get(topic.name)
            missing = (now - self._since) / NANOSECONDS if age is None else age
            if missing < PATIENCE:
                if self._told.pop(topic, 0):
                    self._node.get_logger().info(f'{self._full(topic)} comes')
            elif now >= self._told.get(topic, 0):
                self._told[topic] = now + REPEAT_TIME
                self._node.get_logger().warning(self.describe(topic, missing))

    def describe(self, topic: Topic, missing: float) -> str:
        """Return what is wrong with a topic that has not come for some time [s]."""
        profile, content = self._inputs[topic]
        full = self._full(topic)
        publishers = self._node.get_publishers_info_by_topic(full)
        types = {x.topic_type for x in publishers} - {topic.type_name}
        unlike = quality_mismatches(self._node, full, profile, publishing=False)
        if not publishers:
            source = 'the driver of the robot' if topic.publisher == SIM else topic.publisher
            found = (f'nobody publishes it: start {source}, or give its topic, -r '
                     f'{topic.name}:=/its/topic')
        elif types:
            found = f'it is published as {", ".join(sorted(types))}'
        elif unlike:
            found = '; '.join(unlike)
        else:
            found = (f"{counted(len(publishers), 'publishers')} connected, but nothing is sent "
                     'that can be read')
        reliability = 'reliable' if profile.reliability == ReliabilityPolicy.RELIABLE else (
            'reliable or best effort')
        return (f'no message on {full} for {missing:.1f} s: expected {topic.type_name} '
                f'({reliability}) with {content}; {found}')

    def _full(self, topic: Topic) -> str:
        return str(self._node.resolve_topic_name(topic.name))
