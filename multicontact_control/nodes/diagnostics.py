"""What a node says of itself once a second, as `diagnostic_msgs`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from multicontact_control.nodes import topics
from multicontact_control.nodes.graph_node import create_publisher, Refusals
from multicontact_control.nodes.loop_statistics import Freshness
from rclpy.node import Node

PERIOD = 1_000_000_000  # ns
STALE_PERIODS = 25  # from which an input at the control rate is stale
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@dataclass(frozen=True)
class Status:
    """
    One aspect of a node.

    Attributes
    ----------
    part
        Which, e.g. ``loop``.
    values
        Numbers and texts by name; None is shown as ``none``.
    warning, error
        What is not as it should be, if anything.

    """

    part: str
    values: Mapping[str, Any] = field(default_factory=dict)
    warning: str = ''
    error: str = ''


class Diagnostics:
    """
    Publishes the state of a node when it has time for it.

    Not on a timer: it is the node's loop that knows when nobody waits for it, and a second is a
    second whatever the node takes for its time. `collect` returns what there is to say.
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
            self.publish()

    def publish(self) -> None:
        """Publish now."""
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        name = self._node.get_fully_qualified_name().lstrip('/')
        message.status = [_message(name, status) for status in self._collect()]
        self._publisher.publish(message)


def _message(node_name: str, status: Status) -> DiagnosticStatus:
    level = ERROR if status.error else WARN if status.warning else OK
    return DiagnosticStatus(
        name=f'{node_name}: {status.part}', level=level,
        message=status.error or status.warning or 'ok',
        values=[KeyValue(key=key, value=_text(value)) for key, value in status.values.items()])


def _text(value: Any) -> str:
    if value is None:
        return 'none'
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def input_status(
    freshness: Freshness, max_age: float, *, needed: bool, consequence: str = '',
) -> Status:
    """
    Return how old the inputs of a node are.

    Parameters
    ----------
    freshness
        When they came.
    max_age
        Age from which one is stale [s].
    needed
        Whether that matters now.
    consequence
        What the node does about it.

    """
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
        'refused': refusals.total, **dropped,
        **{f'refused {cause}': count for cause, count in refusals.counts.items()}})
