"""What a node says of itself and of its inputs once a second: `diagnostic_msgs`, and its log."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from multicontact_control.errors import counted
from multicontact_control.nodes import topics
from multicontact_control.nodes.graph_node import create_publisher, quality_mismatches, Refusals
from multicontact_control.nodes.loop_statistics import Freshness, NANOSECONDS
from multicontact_control.nodes.topics import SIM, Topic
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

PERIOD = 1_000_000_000  # ns
STALE_PERIODS = 25  # from which an input at the control rate is stale
MISSING_AGE = 1.0  # s without a message, from which on a topic is missing
REMINDER_PERIOD = 30 * NANOSECONDS  # ns
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@dataclass(frozen=True)
class Status:
    """A part of a node, e.g. ``loop``: values by name, and what is not as it should be."""

    part: str
    values: Mapping[str, Any] = field(default_factory=dict)
    warning: str = ''
    error: str = ''


class Diagnostics:
    """
    Publishes what `collect` returns of a node, once a second.

    Not on a timer: the node's loop knows when it has time, and a second is one of the wall clock.
    """

    def __init__(self, node: Node, collect: Callable[[], Sequence[Status]]) -> None:
        self._node = node
        self._collect = collect
        self._publisher = create_publisher(node, topics.DIAGNOSTICS)
        self._next = time.monotonic_ns() + PERIOD

    def poll(self) -> None:
        """Publish if a second has passed; costs next to nothing otherwise."""
        now = time.monotonic_ns()
        if now >= self._next:
            # No burst after a pause.
            self._next = max(self._next + PERIOD, now + PERIOD // 2)
            name = self._node.get_fully_qualified_name().lstrip('/')
            message = DiagnosticArray(status=[DiagnosticStatus(
                name=f'{name}: {status.part}', level=ERROR if status.error else
                WARN if status.warning else OK, message=status.error or status.warning or 'ok',
                values=[KeyValue(key=key, value=_text(x)) for key, x in status.values.items()])
                for status in self._collect()])
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._publisher.publish(message)


def _text(value: Any) -> str:
    if value is None:
        return 'none'
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def input_status(
    freshness: Freshness, max_age: float, *, needed: bool, consequence: str = '',
) -> Status:
    """Return the ages of inputs; if `needed`, which are older than `max_age` [s], and so what."""
    ages = freshness.ages()
    stale = [f'{name} for {age:.3g} s' if age is not None else f'{name} ever'
             for name, age in ages.items() if age is None or age > max_age]
    values = {f'age_s {name}': None if age is None else round(age, 6)
              for name, age in ages.items()}
    text = f'no {", no ".join(stale)}{consequence}' if stale and needed else ''
    return Status('inputs', values, warning=text)


def message_status(refusals: Refusals, **dropped: int) -> Status:
    """Return what was refused, by cause, and what was dropped."""
    return Status('messages', {
        'refused': sum(refusals.counts.values()), **dropped,
        **{f'refused {cause}': count for cause, count in refusals.counts.items()}})


class MissingInputs:
    """
    Logs which inputs of a node do not come for a second.

    Parameters
    ----------
    node, fresh
        The node, and when each input came last.
    inputs
        Quality of service that each must have at least, and what is expected in it.

    """

    def __init__(
        self, node: Node, fresh: Freshness, inputs: Mapping[Topic, tuple[QoSProfile, str]],
    ) -> None:
        self._node, self._fresh, self._inputs = node, fresh, inputs
        self._reminders: dict[Topic, int] = {}  # when those that are missing are due again
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
            if missing < MISSING_AGE:
                if self._reminders.pop(topic, 0):
                    self._node.get_logger().info(
                        f'{self._node.resolve_topic_name(topic.name)} comes')
            elif now >= self._reminders.get(topic, 0):
                self._reminders[topic] = now + REMINDER_PERIOD
                self._node.get_logger().warning(self._describe(topic, missing))

    def _describe(self, topic: Topic, missing: float) -> str:
        """Return what is wrong with a topic that has not come for some time [s]."""
        profile, content = self._inputs[topic]
        full = str(self._node.resolve_topic_name(topic.name))
        publishers = self._node.get_publishers_info_by_topic(full)
        types = {x.topic_type for x in publishers} - {topic.type_name}
        found = '; '.join(quality_mismatches(self._node, full, profile))
        if not publishers:
            source = 'the driver of the robot' if topic.publisher == SIM else topic.publisher
            found = (f'it has no publisher: start {source}, or give its topic, -r '
                     f'{topic.name}:=/its/topic')
        elif types:
            found = f'it is published as {", ".join(sorted(types))}'
        found = found or (f"{counted(len(publishers), 'publishers')} connected, but nothing is "
                          'sent that can be read')
        reliability = 'reliable' if profile.reliability == ReliabilityPolicy.RELIABLE else (
            'reliable or best effort')
        return (f'no message on {full} for {missing:.1f} s: expected {topic.type_name} '
                f'({reliability}) with {content}; {found}')
