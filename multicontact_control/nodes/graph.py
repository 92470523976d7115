"""What the nodes share: publishers from the table, the start-up gate, counting what is refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
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
from multicontact_control.nodes.topics import RECORDER, Topic, TOPICS
from multicontact_control.process import claim_processor
from rclpy.exceptions import NameValidationException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.validate_full_topic_name import validate_full_topic_name
from std_msgs.msg import Empty

GATE_PERIOD = 0.02  # s, between two looks at whether the gate opens
REPORT_PERIOD = 5.0  # s, between two logs of what is missing
SAFE_TIME = 0.5  # s, in which a robot gets the safe behaviour before it gets nothing
READY = '_ready/'  # and the name of a node: topic whose publisher says that it is ready


class StartupConfig(Config):
    """Parameters that every node of the graph has: peers, scheduling and a file of counts."""

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
        """Write counts of a run and the node's own times to `timing_file`, if that is given."""
        if not self.timing_file:
            return
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
    """
    Return the full name of a topic, e.g. ``/arm/joint_states``.

    Parameters
    ----------
    field
        Parameter or option that has the name, for an error.
    name
        Absolute, relative or, with ~/, private name.
    node
        Node that it is relative to; None for the root.

    Raises
    ------
    ConfigError
        If ROS accepts no such name.

    """
    node_name = '_'
    namespace = '/'
    if node is not None:
        node_name = node.get_name()
        namespace = node.get_namespace()
    try:
        full_name = str(expand_topic_name(name, node_name, namespace))
        validate_full_topic_name(full_name)
    except (NameValidationException, ValueError) as error:
        raise ConfigError(
            field, 'a name of a topic', f"'{name}' ({shorten_ros_error(error)})"
        ) from None
    return full_name


def create_publisher(node: Node, topic: Topic) -> Publisher:
    """Return a new publisher of a topic of the table `TOPICS`, with the topic's profile."""
    return node.create_publisher(topic.message, topic.name, topic.profile)


def offers_enough(offered: QoSProfile, requested: QoSProfile) -> bool:
    """Return whether a publisher offers the reliability and durability that a reader requests."""
    # rclpy's own check takes the endless deadline of a discovered reader for one that is set.
    return bool(
        offered.reliability <= requested.reliability
        and offered.durability <= requested.durability
    )


def take_message(subscription: Subscription) -> tuple[Any, dict[str, Any]] | None:
    """
    Return the next message that waits at a subscription and its information, None if none waits.

    No executor is needed: one that spins the subscription's node takes the messages away. The
    information has the times and the number of the publication.
    """
    with subscription.handle:
        taken: tuple[Any, dict[str, Any]] | None = subscription.handle.take_message(
            subscription.msg_type, subscription.raw
        )
    return taken


def ignore_message(_message: object) -> None:
    """Stand in for the callback of a subscription whose messages are taken by `take_message`."""


class RefusalLog:
    """
    Counts messages, requests and changes that are refused, and logs each cause once.

    Attributes
    ----------
    counts
        Refusals by cause: source and error without the value that was found.

    """

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self.counts: Counter[str] = Counter()

    def log_refusal(self, source: str, error: Exception) -> None:
        """
        Count a refusal; log it if it is the first of its cause.

        Parameters
        ----------
        source
            Name of the topic, service or parameter.
        error
            What was expected and what was found.

        """
        cause, _, _ = f'{source}: {error}'.partition(', got ')
        self.counts[cause] += 1
        if self.counts[cause] == 1:
            self._logger.error(
                f'{source}: refused: {error} (further ones are only counted)'
            )

    @contextmanager
    def logging_refusals(self, topic: Topic) -> Iterator[None]:
        """Log a message of a topic as refused if its use inside raises a MulticontactError."""
        try:
            yield
        except MulticontactError as error:
            self.log_refusal(topic.name, error)


class StartupGate:
    """
    Holds a node back until the graph is connected, so that no message is lost to discovery.

    A writer that sees its reader cannot know that the reader sees it, too: each node looks at its
    own publishers and subscriptions, then creates a hidden publisher, its marker; the gate opens
    when all peers have one. Also claims processors, priority and memory for the node's thread.

    Attributes
    ----------
    open
        Whether all peers are ready; at once if there are none.
    marker
        The publisher by which peers know that this node is ready, None before.

    """

    def __init__(self, node: Node, config: StartupConfig) -> None:
        self._node = node
        self._peers = config.startup_peers
        topics = {node.resolve_topic_name(topic.name): topic for topic in TOPICS}
        self._publishers = _pair_with_topics(node.publishers, topics)
        self._subscriptions = _pair_with_topics(node.subscriptions, topics)
        self.marker: Publisher | None = None
        self.open = not self._peers
        self._poll_due = 0.0
        self._report_due = time.monotonic() + REPORT_PERIOD
        # By now all memory is there, and the threads of the middleware keep their own priority.
        for problem in claim_processor(
            fifo_priority=config.fifo_priority,
            cpus=config.cpus,
            lock_memory=config.lock_memory,
        ):
            node.get_logger().warning(problem)

    def poll(self) -> bool:
        """Return whether the gate is open; every `REPORT_PERIOD` log what it still waits for."""
        now = time.monotonic()
        if self.open or now < self._poll_due:
            return self.open
        self._poll_due = now + GATE_PERIOD
        missing = self._list_missing()
        self.open = not missing
        if missing and now > self._report_due:
            self._report_due = now + REPORT_PERIOD
            self._node.get_logger().info(f'waiting for {"; ".join(missing)}')
        return self.open

    def _list_missing(self) -> list[str]:
        """Return the ends that the node still waits for, then the peers that are not ready."""
        missing = [*self._list_missing_publishers(), *self._list_missing_readers()]
        if missing:
            return missing
        if self.marker is None:
            self.marker = self._node.create_publisher(
                Empty, READY + self._node.get_name(), qos.LATCHED
            )
        return [
            f'{peer} to be ready'
            for peer in self._peers
            if self._node.count_publishers(READY + peer) == 0
        ]

    def _list_missing_publishers(self) -> Iterator[str]:
        for topic, subscription in self._subscriptions:
            if topic.publisher in self._peers:
                if subscription.get_publisher_count() == 0:
                    yield f'{topic.name} from {topic.publisher}'

    def _list_missing_readers(self) -> Iterator[str]:
        namespace = self._node.get_namespace()
        for topic, publisher in self._publishers:
            readers = 0  # that can be connected
            present = set()
            for reader in self._node.get_subscriptions_info_by_topic(
                publisher.topic_name
            ):
                if offers_enough(publisher.qos_profile, reader.qos_profile):
                    readers += 1
                    if reader.node_namespace == namespace:
                        present.add(reader.node_name)
            wanted = {RECORDER, *topic.subscribers} & set(self._peers)
            absent = wanted - present
            # Known by name is not yet connected: every reader that can be must be.
            if absent or publisher.get_subscription_count() < readers:
                yield f'{topic.name} to {", ".join(sorted(absent or wanted))}'


def _pair_with_topics(
    ends: Iterable[Any], topics: Mapping[str, Topic]
) -> list[tuple[Topic, Any]]:
    """Return the publishers or subscriptions that are of a topic of the table, with the topic."""
    return [(topics[end.topic_name], end) for end in ends if end.topic_name in topics]
