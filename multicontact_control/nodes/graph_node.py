"""What the nodes share: publishers from the table, the start-up gate, counting what is refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
import time
from typing import Any

from multicontact_control.config import Config, parameter, Real
from multicontact_control.errors import ConfigError, MulticontactError, RunError
from multicontact_control.files import write_json
from multicontact_control.nodes import qos
from multicontact_control.nodes.runtime import loaded_kernels
from multicontact_control.nodes.topics import Topic
from multicontact_control.process import claim_processor, describe_claim
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.validate_full_topic_name import validate_full_topic_name
from std_msgs.msg import Empty

GATE_POLL = 0.02
REPORT_PERIOD = 5.0
NAMED = 3  # connections that a line names
NAMELESS = '_NODE_NAME_UNKNOWN_'  # what ROS 2 says until the node of a topic's end is known, too
UNNAMED = 'a node whose name is not known'


class StartupConfig(Config):
    """What every node of the graph has in common."""

    startup_peers: tuple[str, ...] = parameter(
        (), 'Nodes to wait for before the first message; empty to start at once.')
    startup_timeout: Real = parameter(
        0.0, 'Longest wait for them; 0 for any time, since who started them watches them all.',
        unit='s', ge=0.0)
    timing_file: str = parameter('', 'JSON file to write counts and times to at the end.')
    fifo_priority: int = parameter(
        0, 'Real-time priority (SCHED_FIFO) of the node, 0 for normal scheduling.', ge=0, le=99)
    cpus: tuple[int, ...] = parameter((), 'Processors the node may run on; empty for all.')
    lock_memory: bool = parameter(
        False, 'Whether none of the memory of the process may be paged out.')

    def write_counts(self, counts: Mapping[str, Any]) -> None:
        """Write the counts and times of a run, and how many kernels it compiled, if asked to."""
        if self.timing_file:
            kernels = loaded_kernels()
            write_json(Path(self.timing_file), {
                **counts, 'kernels_compiled': kernels.compiled_here() if kernels else 0,
                'scheduling': describe_claim()})


def full_topic_name(field: str, name: str, node: Node | None = None) -> str:
    """
    Return the full name of a topic, before it is remapped.

    Parameters
    ----------
    field
        What is said to be wrong if it is.
    name
        Name, relative or full.
    node
        Whose; without one a relative name is of the root namespace.

    Raises
    ------
    ConfigError
        If ROS accepts no such name.

    """
    whose = ('_', '/') if node is None else (node.get_name(), node.get_namespace())
    try:
        full = str(expand_topic_name(name, *whose))
        validate_full_topic_name(full)
    except (NameValidationException, ValueError) as error:
        why = str(error).splitlines()[0].split(', at /')[0].split(': ', 1)[1]
        raise ConfigError(field, 'a name of a topic', f"'{name}' ({why.rstrip(':')})") from None
    return full


def create_publisher(node: Node, topic: Topic) -> Publisher:
    """Create the publisher of a topic of the table."""
    return node.create_publisher(topic.message, topic.name, topic.profile)


def create_subscription(
    node: Node, topic: Topic, callback: Callable[[Any], None], profile: QoSProfile, *,
    raw: bool = False, strict: bool = True,
) -> Subscription:
    """Subscribe to a topic of the table; `strict` logs publishers that cannot serve it."""
    return node.create_subscription(
        topic.message, topic.name, callback, profile, raw=raw,
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=strict))


def all_are_heard(node: Node, subscription: Subscription) -> bool:
    """Return whether every publisher of a topic that is known is connected: a matter of 20 us."""
    known = node.count_publishers(subscription.topic_name)
    return bool(known <= subscription.get_publisher_count())


def served_profile(node: Node, full_name: str, profile: QoSProfile) -> QoSProfile:
    """Return a profile, or best effort where a publisher that is known gives no more than that."""
    return qos.profile(profile.depth, reliable=False) if quality_mismatches(
        node, full_name, profile, publishing=False) else profile


def quality_mismatches(
    node: Node, full_name: str, profile: QoSProfile, *, publishing: bool,
) -> list[str]:
    """Return with whom an end of a topic, the publisher's or not, cannot connect, and why."""
    others = (node.get_subscriptions_info_by_topic if publishing
              else node.get_publishers_info_by_topic)(full_name)
    found = []
    for other in others:
        offered, requested = (profile, other.qos_profile) if publishing else (
            other.qos_profile, profile)
        policies = _unlike_policies(offered, requested)
        if policies:
            who = UNNAMED if other.node_name == NAMELESS else (
                f'{other.node_namespace.rstrip("/")}/{other.node_name}')
            found.append(
                f'no message goes {"to" if publishing else "from"} {who}: ' + ', '.join(
                    f'{policy} is {offers} by the publisher and {wants} by the subscriber'
                    for policy, offers, wants in policies))
    return found


def take(subscription: Subscription) -> tuple[Any, dict[str, Any]] | None:
    """Return the next message that waits, and what is known of it; no executor is needed."""
    handle = subscription.handle
    with handle:
        taken: tuple[Any, dict[str, Any]] | None = handle.take_message(
            subscription.msg_type, subscription.raw)
    return taken


def ignore(_message: object) -> None:
    """Stand in for the callback of a subscription whose messages are taken."""


def ready_topic(node_name: str) -> str:
    """Return the topic whose publisher says that a node is ready."""
    return f'_ready/{node_name}'


class Refusals:
    """
    Counts what was refused, and logs it once per cause.

    Attributes
    ----------
    counts
        By cause.

    """

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self.counts: Counter[str] = Counter()

    def refuse(self, source: str, error: Exception) -> None:
        """Take note of what came from a topic, service or parameter and cannot be used."""
        cause = getattr(error, 'cause', '') or str(error).split(', found ')[0]
        cause = f'{source}: {cause}'
        self.counts[cause] += 1
        if self.counts[cause] == 1:
            self._logger.error(f'{source}: refused: {error} (further ones are only counted)')

    @contextmanager
    def guard(self, topic: Topic) -> Iterator[None]:
        """Refuse what raises a named error inside."""
        try:
            yield
        except MulticontactError as error:
            self.refuse(topic.name, error)

    @property
    def total(self) -> int:
        """How many there were."""
        return sum(self.counts.values())


class StartupGate:
    """
    Holds a node back until the graph is connected, so that no message is lost to discovery.

    A writer that sees its reader cannot know that the reader sees it, too, and takes what is
    sent. So each node looks at both ends of its own, then says that it is ready by creating a
    (hidden) publisher that is never used, and the gate opens when all peers have said so.

    Parameters
    ----------
    node
        The node.
    publishers, subscriptions
        Its ends of the topics.
    config
        Whom to wait for, and how long.

    """

    def __init__(
        self, node: Node, publishers: Mapping[Topic, Publisher],
        subscriptions: Mapping[Topic, Subscription], config: StartupConfig,
    ) -> None:
        self._node = node
        self._publishers = publishers
        self._subscriptions = subscriptions
        self._config = config
        self._marker: Publisher | None = None
        self._start = time.monotonic()
        self._next_poll = self._start
        self._next_report = self._start + REPORT_PERIOD
        self.open = not config.startup_peers
        # By now all memory is there, and the threads of the middleware keep their own priority.
        for problem in claim_processor(
                fifo_priority=config.fifo_priority, cpus=config.cpus,
                lock_memory=config.lock_memory):
            node.get_logger().warning(problem)

    def poll(self) -> bool:
        """
        Return whether the gate is open; costs nothing once it is.

        Raises
        ------
        RunError
            Naming the connections that are missing when the time is over.

        """
        if self.open:
            return True
        now = time.monotonic()
        if now < self._next_poll:
            return False
        self._next_poll = now + GATE_POLL
        missing = self.missing()
        self.open = not missing
        if missing and 0.0 < self._config.startup_timeout < now - self._start:
            raise RunError('not connected after '
                           f'{self._config.startup_timeout:g} s: {_first_few(missing)}')
        if missing and now > self._next_report:
            self._next_report = now + REPORT_PERIOD
            self._node.get_logger().info(f'waiting for {_first_few(missing)}')
        return self.open

    def missing(self) -> list[str]:
        """Return what the node still waits for."""
        missing = self._missing_readers() + self._missing_writers()
        if missing:
            return missing
        if self._marker is None:
            self._marker = self._node.create_publisher(
                Empty, ready_topic(self._node.get_name()), qos.LATCHED)
        return [
            f'{peer} to be ready' for peer in self._config.startup_peers
            if self._node.count_publishers(ready_topic(peer)) == 0]

    def _missing_readers(self) -> list[str]:
        missing = []
        for topic, publisher in self._publishers.items():
            wanted = [x for x in topic.subscribers if x in self._config.startup_peers]
            present, readers = self._readers(publisher)
            absent = sorted(set(wanted) - present)
            # Known by name is not yet connected: every reader that can be must be.
            if absent or publisher.get_subscription_count() < readers:
                missing.append(f'{topic.name} to {", ".join(absent or wanted)}')
        return missing

    def _missing_writers(self) -> list[str]:
        return [
            f'{topic.name} from {topic.publisher}'
            for topic, subscription in self._subscriptions.items()
            if topic.publisher in self._config.startup_peers
            and subscription.get_publisher_count() == 0]

    def _readers(self, publisher: Publisher) -> tuple[set[str], int]:
        """Return the names of the nodes that read a topic, and how many readers can connect."""
        names, count = set(), 0
        namespace = self._node.get_namespace()
        for info in self._node.get_subscriptions_info_by_topic(publisher.topic_name):
            if not _unlike_policies(publisher.qos_profile, info.qos_profile):
                count += 1
                if info.node_namespace == namespace:
                    names.add(info.node_name)
        return names, count


def _first_few(missing: list[str]) -> str:
    """Return what is missing in one line: there may be dozens."""
    more = f' and {len(missing) - NAMED} more' if len(missing) > NAMED else ''
    return f'{"; ".join(missing[:NAMED])}{more}'


def _unlike_policies(offered: QoSProfile, requested: QoSProfile) -> list[tuple[str, str, str]]:
    """Return policies of which less is offered than requested, and what is."""
    # rclpy's own check takes the endless deadline of a discovered reader for one that is set.
    found = []
    if offered.reliability == ReliabilityPolicy.BEST_EFFORT and (
            requested.reliability == ReliabilityPolicy.RELIABLE):
        found.append(('reliability', 'best effort', 'reliable'))
    if offered.durability == DurabilityPolicy.VOLATILE and (
            requested.durability == DurabilityPolicy.TRANSIENT_LOCAL):
        found.append(('durability', 'volatile', 'transient local'))
    return [(policy, f'offered as {offers}', f'requested as {wants}')
            for policy, offers, wants in found]
