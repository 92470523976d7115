"""What a node says of itself and of its inputs once a second: `diagnostic_msgs`, and its log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from multicontact_control.arrays import Vector
from multicontact_control.nodes import topics
from multicontact_control.nodes.background import BackgroundThread
from multicontact_control.nodes.graph import create_publisher, RefusalLog
from multicontact_control.nodes.topics import CONTROLLER, ESTIMATOR, SIM, Topic
from multicontact_control.sampling import NANOSECONDS
import numpy as np
from rclpy.node import Node
from rclpy.serialization import serialize_message

# Publishers of inputs that say themselves why they are silent. SIM, which stands for any robot, is
# not one of them.
SELF_REPORTING = (CONTROLLER, ESTIMATOR)
PERIOD = NANOSECONDS  # ns, from report to report: one second
# ns, between two steps of a report: samples of 500 Hz come in between.
PAUSE = 5_000_000
NO_STEP_LEFT = object()
# Age of a stale input, in periods: more than a busy machine delays a message.
STALE_PERIODS = 25
# s of silence that an operator should know of; a shorter one is in the report.
MISSING_AGE = 1.0
DISCOVERY_TIME = 3.0  # s in which nodes that start together find each other
CAPACITY = 1 << 18  # durations: 8 minutes at 500 Hz, 4 at 1 kHz
PERCENTILES = {'p50': 50.0, 'p99': 99.0, 'p999': 99.9, 'max': 100.0}


@dataclass(frozen=True)
class ComponentStatus:
    """
    The status of a component of a node, e.g. ``loop``: one entry of a diagnostics message.

    A warning or an error names the fault, what is expected and what was found; the error counts
    where there are both.
    """

    component: str
    # By key, for operators.
    values: Mapping[str, Any] = field(default_factory=dict)
    warning: str = ''
    error: str = ''


def build_status_message(name: str, status: ComponentStatus) -> DiagnosticStatus:
    """
    Return the message with the status of a component, named after its node.

    Numbers are written with 6 significant digits, None as ``none``.
    """
    level = DiagnosticStatus.OK
    if status.error:
        level = DiagnosticStatus.ERROR
    elif status.warning:
        level = DiagnosticStatus.WARN
    return DiagnosticStatus(
        name=f'{name}: {status.component}',
        message=status.error or status.warning or 'ok',
        level=level,
        values=[
            KeyValue(key=key, value=_format_value(value))
            for key, value in status.values.items()
        ],
    )


def _format_value(value: Any) -> str:
    if value is None:
        return 'none'
    if isinstance(value, float):
        return f'{value:.6g}'
    return str(value)


def serialize_report(node: Node, statuses: Iterable[ComponentStatus]) -> bytes:
    """Return the serialised message of a whole report of a node, stamped by the node's clock."""
    name = node.get_fully_qualified_name().lstrip('/')
    message = DiagnosticArray(
        status=[build_status_message(name, status) for status in statuses]
    )
    message.header.stamp = node.get_clock().now().to_msg()
    return bytes(serialize_message(message))


class DiagnosticsPublisher:
    """
    Publishes the statuses of a node's components, once a second of the wall clock.

    No sample waits for a whole report: `poll` makes one step of it at a time, with `PAUSE` between
    two of them, and the background thread serialises the message.

    Parameters
    ----------
    node
        The node that publishes.
    collect
        Yields the statuses, and None where its own work may pause.
    background
        Serialises the message.

    """

    def __init__(
        self,
        node: Node,
        collect: Callable[[], Iterable[ComponentStatus | None]],
        background: BackgroundThread,
    ) -> None:
        self._node = node
        self._collect = collect
        self._background = background
        self._publisher = create_publisher(node, topics.DIAGNOSTICS)
        self._report_due = time.monotonic_ns() + PERIOD
        self._step_due = self._report_due
        self._steps: Iterator[None] | None = None  # of the report that is being made

    def restart(self) -> None:
        """Drop the rest of the present report, if there is one, and wait until the next is due."""
        self._steps = None
        self._step_due = self._report_due

    def poll(self) -> None:
        """Make a step of a report if it is due; the node's loop calls this between samples."""
        now = time.monotonic_ns()
        if now < self._step_due:
            return
        self._step_due = now + PAUSE
        if self._steps is None:
            self._steps = self._make_report()
            # Half a period from now at least: no burst of reports after a pause.
            self._report_due = max(self._report_due + PERIOD, now + PERIOD // 2)
        if next(self._steps, NO_STEP_LEFT) is NO_STEP_LEFT:
            self.restart()

    def _make_report(self) -> Iterator[None]:
        """Publish one report, and yield between its steps."""
        statuses = []
        for status in self._collect():
            yield
            if status is not None:
                statuses.append(status)
        yield
        serialised = yield from self._background.compute(
            serialize_report, self._node, statuses
        )
        self._publisher.publish(serialised.result())


class DurationLog:
    """
    Durations of a loop: the newest `CAPACITY` of them, and the `count` of all.

    The loop adds durations while another thread reads: `skip` and `end`, two counts, choose the
    durations that are read.
    """

    def __init__(self) -> None:
        self._nanoseconds = np.zeros(CAPACITY, dtype=np.int64)
        self.count = 0

    def add(self, nanoseconds: int) -> None:
        """Keep one duration [ns]; it takes the place of the oldest if the log is full."""
        self._nanoseconds[self.count % CAPACITY] = nanoseconds
        self.count += 1

    def microseconds(self, skip: int = 0, end: int | None = None) -> Vector:
        """Return what is kept of the first `end` durations without the first `skip` [us]."""
        if end is None:
            end = self.count
        first = max(skip, end - CAPACITY)
        places = np.arange(first, end) % CAPACITY
        return np.asarray(1e-3 * self._nanoseconds[places])

    def percentiles(
        self, skip: int = 0, end: int | None = None, *, expected: float = 0.0
    ) -> dict[str, float | None]:
        """
        Return median, tails and maximum of the absolute deviations from a duration [us].

        Without an `expected` duration [us] these are the durations themselves. `skip` and `end`
        are as in `microseconds`; without a duration between them all are None.
        """
        deviations = np.abs(self.microseconds(skip, end) - expected)
        if not deviations.size:
            return dict.fromkeys(PERCENTILES)
        deviations.sort()  # np.percentile takes several times as long
        last = deviations.size - 1
        places = np.array([*PERCENTILES.values()]) / 100.0 * last
        values = np.interp(places, np.arange(deviations.size), deviations).round(3)
        return dict(zip(PERCENTILES, values.tolist()))


class LoopStatistics:
    """
    Rate, jitter and latency of a loop that should run at `rate` [Hz], since the last report.

    The loop adds turns and latencies while another thread may make the report.

    Attributes
    ----------
    intervals, latencies
        Durations between turns of the loop, and those that its node adds: from an input to the
        answer.
    last
        Time of the newest turn, monotonic time [ns]; 0 before the first.

    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self.intervals = DurationLog()
        self.latencies = DurationLog()
        self.last = 0
        self._report_start = time.monotonic_ns()
        self._reported_turns = 0
        self._reported_answers = 0

    def add_turn(self, now: int) -> None:
        """Count a turn of the loop at a monotonic time [ns]."""
        if self.last:
            self.intervals.add(now - self.last)
        self.last = now

    def report(self) -> dict[str, float | None]:
        """Return the statistics since the last call; jitter is the deviation from the period."""
        # The loop may go on meanwhile: what it adds from now on is in the next report.
        now = time.monotonic_ns()
        turns = self.intervals.count
        answers = self.latencies.count
        elapsed = max(1, now - self._report_start)
        jitter = self.intervals.percentiles(
            self._reported_turns, turns, expected=1e6 / self._rate
        )
        latency = self.latencies.percentiles(self._reported_answers, answers)
        rate = (turns - self._reported_turns) * NANOSECONDS / elapsed
        values: dict[str, float | None] = {'rate_hz': round(rate, 2)}
        for name in ('p50', 'p99'):
            values[f'jitter_us_{name}'] = jitter[name]
        for name in ('p50', 'p99', 'max'):
            values[f'latency_us_{name}'] = latency[name]
        self._report_start = now
        self._reported_turns = turns
        self._reported_answers = answers
        return values


class InputMonitor:
    """
    Knows when each input came last; logs inputs that are missing, and those that come again.

    An input from one of our own nodes is logged as missing only if it has never come: a node that
    falls silent says why itself. The same holds for all inputs from a robot that may pause.

    Parameters
    ----------
    node, rate, inputs
        The node that needs the inputs, their rate [Hz], and their topics.
    may_pause
        Whether the robot may stop sending, as in lockstep.

    Attributes
    ----------
    last
        When each input came last, monotonic time [ns]; 0 for never. Its node writes here.
    max_age
        Age from which an input is stale [s].

    """

    def __init__(
        self, node: Node, rate: float, *inputs: Topic, may_pause: bool = False
    ) -> None:
        self._node = node
        self._may_pause = may_pause
        self.max_age = STALE_PERIODS / rate
        self.last = dict.fromkeys(inputs, 0)
        self.restart()

    def restart(self) -> None:
        """Wait for all inputs from now on, as if none had come."""
        self.last = dict.fromkeys(self.last, 0)
        self._start = time.monotonic_ns()
        self._logged_missing: set[Topic] = set()

    def age(self, topic: Topic) -> float:
        """Return how long ago an input came last [s], infinity if it never has."""
        last = self.last[topic]
        return (time.monotonic_ns() - last) * 1e-9 if last else math.inf

    def status(self, *, needed: bool, consequence: str = '') -> ComponentStatus:
        """
        Return the ages of the inputs, and log those that begin or cease to be missing.

        Parameters
        ----------
        needed
            Whether the node works with its inputs now: else their silence is no fault.
        consequence
            What the node does without them, e.g. ': the last R is held'; ends a warning.

        """
        values: dict[str, float | None] = {}
        warnings = []
        for topic in self.last:
            age = self.age(topic)
            values[f'age_s {topic.name}'] = age if age < math.inf else None
            if not needed:
                continue
            self._log_change(topic, age > self.max_age)
            if age == math.inf:
                warnings.append(f'no {topic.name} ever')
            elif age > self.max_age:
                warnings.append(f'no {topic.name} for {age:.3g} s')
        warning = ', '.join(warnings)
        if warning:
            warning += consequence
        return ComponentStatus('inputs', values, warning)

    def _log_change(self, topic: Topic, stale: bool) -> None:
        """Log once that a stale topic is missing, and once that it comes, then or again."""
        if stale == (topic in self._logged_missing):
            return  # nothing new: the graph, which is slow to ask, is not asked
        if not stale:
            name = self._node.resolve_topic_name(topic.name)
            self._logged_missing.remove(topic)
            self._node.get_logger().warning(f'messages on {name} come now')
        elif self._is_missing(topic):
            self._logged_missing.add(topic)
            self._node.get_logger().warning(self._describe_missing(topic))

    def _silence(self, topic: Topic) -> float:
        """Return for how long a topic has been waited for [s]."""
        return (time.monotonic_ns() - (self.last[topic] or self._start)) / NANOSECONDS

    def _is_missing(self, topic: Topic) -> bool:
        """Return whether a stale topic has been silent so long that an operator should know."""
        if not self.last[topic]:
            return self._silence(topic) >= DISCOVERY_TIME
        may_be_silent = self._may_pause or topic.publisher in SELF_REPORTING
        return not may_be_silent and self._silence(topic) >= MISSING_AGE

    def _describe_missing(self, topic: Topic) -> str:
        """Return the log line of a missing topic: what the graph has of it, what is expected."""
        name = self._node.resolve_topic_name(topic.name)
        publishers = self._node.get_publishers_info_by_topic(name)
        types = {publisher.topic_type for publisher in publishers} - {topic.type_name}
        if not publishers:
            source = topic.publisher
            if source == SIM:
                source = 'the driver of the robot'
            found = (
                f'it has no publisher: start {source}, or give its topic, '
                f'-r {topic.name}:=/its/topic'
            )
        elif types:
            found = f'it is published as {", ".join(sorted(types))}'
        else:
            names = sorted({publisher.node_name for publisher in publishers})
            silent = 'has sent nothing that can be read'
            if self.last[topic]:
                silent = 'sends no more'
            found = f'its publisher, {", ".join(names)}, {silent}'
        # What is found goes first: a terminal cuts a long line.
        return (
            f'no message on {name} for {self._silence(topic):.1f} s: {found}; expected '
            f'{topic.type_name}: {topic.content}'
        )


def refusal_status(refusals: RefusalLog, **counts: int) -> ComponentStatus:
    """
    Return the status of messages: how many were refused, in all and by cause.

    Further `counts` of a node, such as messages that it dropped, stand beside them by their names.
    """
    values = {'refused': refusals.counts.total(), **counts}
    for cause, count in refusals.counts.items():
        values[f'refused {cause}'] = count
    return ComponentStatus('messages', values)
