"""What the nodes share: publishers from the table, the start-up gate, counting what is refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
import time
from typing import Any

from multicontact_control.config import Config, parameter
from multicontact_control.errors import ConfigError, MulticontactError
from multicontact_control.files import replace_json_file
from multicontact_control.nodes import qos
from multicontact_control.nodes.private import RcutilsLogger
from multicontact_control.nodes.runtime import loaded_kernels, shorten_ros_error
from multicontact_control.nodes.topics import Topic, TOPICS
from multicontact_control.process import claim_processor
from rclpy.exceptions import NameValidationException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.validate_full_topic_name import validate_full_topic_name
from std_msgs.msg import Empty

GATE_POLL, REPORT_PERIOD = 0.02, 5.0  # s
SAFE_TIME = 0.5  # s, in which a robot gets the safe behaviour before it gets nothing
READY = '_ready/'  # and the name of a node: topic whose publisher says that it is ready


class StartupConfig(Config):
    """What every node of the graph has in common."""

    startup_peers: tuple[str, ...] = parameter(
        (), 'Nodes to wait for before the first message; empty to start at once.'
    )
    timing_file: str = parameter(
        '', 'JSON file to write counts and times to at the end.'
    )
    fifo_priority: int = parameter(
        0,
        'Real-time priority (SCHED_FIFO) of the node, 0 for normal scheduling.',
        ge=0,
        le=99,
    )
    cpus: tuple[int, ...] = parameter(
        (), 'Processors the node may run on; empty for all.'
    )
    lock_memory: bool = parameter(
        False, 'Whether none of the memory of the process may be paged out.'
    )

    def write_counts(self, counts: Mapping[str, Any]) -> None:
        """Write the counts and times of a run, if asked to."""
        if self.timing_file:
            kernels = loaded_kernels()
            replace_json_file(
                Path(self.timing_file),
                {
                    **counts,
                    'cpu_s': time.process_time(),
                    'kernels_compiled': kernels.count_compilations() if kernels else 0,
                },
            )


def full_topic_name(field: str, name: str, node: Node | None = None) -> str:
    """Return the full name of a topic; ConfigError of a field where ROS accepts no such name."""
    whose = ('_', '/') if node is None else (node.get_name(), node.get_namespace())
    try:
        full = str(expand_topic_name(name, *whose))
        validate_full_topic_name(full)
    except (NameValidationException, ValueError) as error:
        raise ConfigError(
            field, 'a name of a topic', f"'{name}' ({shorten_ros_error(error)})"
        ) from None
    return full


def create_publisher(node: Node, topic: Topic) -> Publisher:
    """Create the publisher of a topic of the table."""
    return node.create_publisher(topic.message, topic.name, topic.profile)


def offers_enough(offered: QoSProfile, requested: QoSProfile) -> bool:
    """Return whether a publisher offers the reliability and durability that a reader requests."""
    # rclpy's own check takes the endless deadline of a discovered reader for one that is set.
    return bool(
        offered.reliability <= requested.reliability
        and offered.durability <= requested.durability
    )


def take_message(subscription: Subscription) -> tuple[Any, dict[str, Any]] | None:
    """Return the next message that waits, and what is known of it; no executor is needed."""
    with subscription.handle:
        taken: tuple[Any, dict[str, Any]] | None = subscription.handle.take_message(
            subscription.msg_type, subscription.raw
        )
    return taken


def ignore_message(_message: object) -> None:
    """Stand in for the callback of a subscription whose messages are taken."""


class RefusalLog:
    """Counts what was refused by cause, and logs it once."""

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self.counts: Counter[str] = Counter()

    def log_refusal(self, source: str, error: Exception) -> None:
        """Take note of what came from a topic, service or parameter and cannot be used."""
        cause = f'{source}: {error}'.split(', got ')[0]
        self.counts[cause] += 1
        if self.counts[cause] == 1:
            self._logger.error(
                f'{source}: refused: {error} (further ones are only counted)'
            )

    @contextmanager
    def logging_refusals(self, topic: Topic) -> Iterator[None]:
        """Count a message of a topic as refused if its use inside raises an error of ours."""
        try:
            yield
        except MulticontactError as error:
            self.log_refusal(topic.name, error)


class StartupGate:
    """
    Holds a node back until the graph is connected, so that no message is lost to discovery.

    A writer that sees its reader cannot know that the reader sees it, too: each node looks at its
    own ends, then creates a hidden publisher; the gate opens when all peers have one.
    """

    def __init__(self, node: Node, config: StartupConfig) -> None:
        self._node, self._peers = node, config.startup_peers
        ends = {node.resolve_topic_name(topic.name): topic for topic in TOPICS}
        self._publishers, self._subscriptions = (
            [(ends[x.topic_name], x) for x in present if x.topic_name in ends]
            for present in (node.publishers, node.subscriptions)
        )
        self.marker: Publisher | None = None
        self.open = not self._peers
        self._next_poll, self._next_report = 0.0, time.monotonic() + REPORT_PERIOD
        # By now all memory is there, and the threads of the middleware keep their own priority.
        for problem in claim_processor(
            fifo_priority=config.fifo_priority,
            cpus=config.cpus,
            lock_memory=config.lock_memory,
        ):
            node.get_logger().warning(problem)

    def poll(self) -> bool:
        """Return whether the gate is open; log now and then what is missing."""
        now = time.monotonic()
        if not self.open and now >= self._next_poll:
            self._next_poll, missing = now + GATE_POLL, self._missing()
            self.open = not missing
            if missing and now > self._next_report:
                self._next_report = now + REPORT_PERIOD
                self._node.get_logger().info(f'waiting for {"; ".join(missing)}')
        return self.open

    def _missing(self) -> list[str]:
        """Return what the node still waits for."""
        missing = [
            f'{topic.name} from {topic.publisher}'
            for topic, subscription in self._subscriptions
            if topic.publisher in self._peers
            and subscription.get_publisher_count() == 0
        ]
        for topic, publisher in self._publishers:
            readers = [
                x
                for x in self._node.get_subscriptions_info_by_topic(
                    publisher.topic_name
                )
                if offers_enough(publisher.qos_profile, x.qos_profile)
            ]
            present = {
                x.node_name
                for x in readers
                if x.node_namespace == self._node.get_namespace()
            }
            wanted = set(topic.subscribers) & set(self._peers)
            # Known by name is not yet connected: every reader that can be must be.
            if wanted - present or publisher.get_subscription_count() < len(readers):
                missing.append(
                    f'{topic.name} to {", ".join(sorted(wanted - present or wanted))}'
                )
        if not missing and self.marker is None:
            self.marker = self._node.create_publisher(
                Empty, READY + self._node.get_name(), qos.LATCHED
            )
        return missing or [
            f'{peer} to be ready'
            for peer in self._peers
            if self._node.count_publishers(READY + peer) == 0
        ]
