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

OURS = (CONTROLLER, ESTIMATOR)  # what publishes inputs of other nodes
PERIOD, PAUSE = NANOSECONDS, 5_000_000  # ns, of reports, and between two steps of one
NO_STEP_LEFT = object()
STALE_PERIODS = 25  # from which an input at the control rate is stale
# s: an input is missed after MISSING_AGE; its first message may take DISCOVERY_TIME.
MISSING_AGE, DISCOVERY_TIME = 1.0, 3.0
CAPACITY = 1 << 18  # durations: 8 minutes at 500 Hz
PERCENTILES = {'p50': 50.0, 'p99': 99.0, 'p999': 99.9, 'max': 100.0}
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@dataclass(frozen=True)
class ComponentStatus:
    """A part of a node, e.g. ``loop``: values by name, and what is not as it should be."""

    part: str
    values: Mapping[str, Any] = field(default_factory=dict)
    warning: str = ''
    error: str = ''


def build_status_message(name: str, status: ComponentStatus) -> DiagnosticStatus:
    """Return the message of a part of a node."""
    return DiagnosticStatus(
        name=f'{name}: {status.part}',
        message=status.error or status.warning or 'ok',
        level=ERROR if status.error else WARN if status.warning else OK,
        values=[
            KeyValue(
                key=key,
                value=(
                    'none'
                    if x is None
                    else f'{x:.6g}'
                    if isinstance(x, float)
                    else str(x)
                ),
            )
            for key, x in status.values.items()
        ],
    )


def serialize_report(node: Node, statuses: Iterable[ComponentStatus]) -> bytes:
    """Return the message of a whole report of a node, serialised."""
    name = node.get_fully_qualified_name().lstrip('/')
    message = DiagnosticArray(
        status=[build_status_message(name, status) for status in statuses]
    )
    message.header.stamp = node.get_clock().now().to_msg()
    return bytes(serialize_message(message))


class DiagnosticsPublisher:
    """
    Publishes what `collect` yields of a node, once a second of the wall clock.

    No sample waits for a whole report: it is made step by step, with `PAUSE` between two of them,
    and the message by the background thread.
    `collect` yields None where its own work may pause.
    """

    def __init__(
        self,
        node: Node,
        collect: Callable[[], Iterable[ComponentStatus | None]],
        background: BackgroundThread,
    ) -> None:
        self._node, self._collect, self._background = node, collect, background
        self._publisher = create_publisher(node, topics.DIAGNOSTICS)
        self._next = self._due = time.monotonic_ns() + PERIOD  # report, and step
        self._steps: Iterator[None] | None = None  # of the report that is being made

    def restart(self) -> None:
        """Drop the report that is being made: what it tells of has gone."""
        self._steps, self._due = None, self._next

    def poll(self) -> None:
        """Do a step if it is due; called by the node's loop, which knows when it can."""
        now = time.monotonic_ns()
        if now < self._due:
            return
        self._due = now + PAUSE
        if self._steps is None:
            self._steps = self._report()
            self._next = max(
                self._next + PERIOD, now + PERIOD // 2
            )  # no burst after a pause
        if next(self._steps, NO_STEP_LEFT) is NO_STEP_LEFT:
            self._steps, self._due = None, self._next

    def _report(self) -> Iterator[None]:
        """Publish one report, and yield between its steps."""
        statuses = []
        for status in self._collect():
            yield
            if status is not None:
                statuses.append(status)
        yield
        message = yield from self._background.compute(
            serialize_report, self._node, statuses
        )
        self._publisher.publish(message.result())


class DurationLog:
    """The newest durations, 8 minutes of them at 500 Hz."""

    def __init__(self) -> None:
        self._nanoseconds = np.zeros(CAPACITY, dtype=np.int64)
        self.count = 0

    def add(self, nanoseconds: int) -> None:
        """Keep one duration [ns]."""
        self._nanoseconds[self.count % CAPACITY] = nanoseconds
        self.count += 1

    def microseconds(self, since: int = 0) -> Vector:
        """Return those that are kept, and came after the first `since` [us]."""
        first = max(since, self.count - CAPACITY)
        return np.asarray(
            1e-3 * self._nanoseconds[np.arange(first, self.count) % CAPACITY]
        )

    def percentiles(
        self, since: int = 0, expected: float = 0.0
    ) -> dict[str, float | None]:
        """Return median, tails and maximum of what is not as `expected` [us]; None without any."""
        off = np.abs(self.microseconds(since) - expected)
        if not off.size:
            return dict.fromkeys(PERCENTILES)
        off.sort()  # np.percentile takes several times as long
        places = np.array([*PERCENTILES.values()]) / 100.0 * (off.size - 1)
        values = np.interp(places, np.arange(off.size), off).round(3)
        return dict(zip(PERCENTILES, values.tolist()))


class LoopStatistics:
    """Rate, jitter and latency of a loop that should run at `rate` [Hz], since the last report."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self.intervals, self.latencies = DurationLog(), DurationLog()
        self._reported = (time.monotonic_ns(), 0, 0)
        self.missed = self.last = (
            0  # deadlines, by the node; the last turn, monotonic time [ns]
        )

    def add_period(self, now: int) -> None:
        """Take note of a turn of the loop at a monotonic time [ns]."""
        if self.last:
            self.intervals.add(now - self.last)
        self.last = now

    def report(self) -> dict[str, float | int | None]:
        """Return what was seen; jitter is the deviation from the period."""
        now, turns, missed = time.monotonic_ns(), self.intervals.count, self.missed
        start, before, answered = self._reported
        self._reported, self.missed = (now, turns, self.latencies.count), 0
        jitter = self.intervals.percentiles(before, 1e6 / self._rate)
        latency = self.latencies.percentiles(answered)
        return {
            'rate_hz': round((turns - before) * NANOSECONDS / max(1, now - start), 2),
            'deadline_misses': missed,
            **{f'jitter_us_{name}': jitter[name] for name in ('p50', 'p99')},
            **{f'latency_us_{name}': latency[name] for name in ('p50', 'p99', 'max')},
        }


class InputMonitor:
    """
    When each input came `last`, monotonic time [ns]; logs what is missing, and what comes again.

    Of our own nodes each says itself why it is silent: what they publish is missed only until it
    has come once. So is all that comes from a robot that `may_pause`, as in lockstep.
    """

    def __init__(
        self,
        node: Node,
        rate: float,
        *inputs: Topic,
        may_pause: bool = False,
    ) -> None:
        self._node, self._may_pause = node, may_pause
        self.max_age = STALE_PERIODS / rate  # s
        self.last = dict.fromkeys(inputs, 0)
        self.restart()

    def restart(self) -> None:
        """Wait for all of them from now on."""
        self.last, self._since = dict.fromkeys(self.last, 0), time.monotonic_ns()
        self._missed: set[Topic] = set()  # what was said to be missing

    def age(self, topic: Topic) -> float:
        """Return how long ago an input came last [s], infinity if it never has."""
        last = self.last[topic]
        return (time.monotonic_ns() - last) * 1e-9 if last else math.inf

    def status(self, *, needed: bool, consequence: str = '') -> ComponentStatus:
        """Return ages; if `needed`, which are above `max_age`, and what is done about it."""
        ages = {topic: self.age(topic) for topic in self.last}
        stale = {
            topic: age for topic, age in ages.items() if needed and age > self.max_age
        }
        if needed:
            for topic in ages:
                self._log_change(topic, topic in stale)
        warning = ', '.join(
            f'no {topic.name} ' + (f'for {age:.3g} s' if age < math.inf else 'ever')
            for topic, age in stale.items()
        )
        return ComponentStatus(
            'inputs',
            {
                f'age_s {topic.name}': age if age < math.inf else None
                for topic, age in ages.items()
            },
            warning and warning + consequence,
        )

    def _log_change(self, topic: Topic, stale: bool) -> None:
        """Log once that a topic is missing, and once that it comes again."""
        if stale == (topic in self._missed):
            return  # what is missing takes long to find out
        change = f'messages on {self._node.resolve_topic_name(topic.name)} come now'
        if stale:
            change = self._missing(topic)
        if change:
            self._missed ^= {topic}
            self._node.get_logger().warning(change)

    def _missing(self, topic: Topic) -> str:
        """Return what is expected of a topic that is missing for long, and what there is."""
        before = self.last[topic] > 0
        if before and (self._may_pause or topic.publisher in OURS):
            return ''
        missing = (
            time.monotonic_ns() - (self.last[topic] or self._since)
        ) / NANOSECONDS
        if missing < (MISSING_AGE if before else DISCOVERY_TIME):
            return ''
        name = self._node.resolve_topic_name(topic.name)
        publishers = self._node.get_publishers_info_by_topic(name)
        types = {x.topic_type for x in publishers} - {topic.type_name}
        source = (
            'the driver of the robot' if topic.publisher == SIM else topic.publisher
        )
        if not publishers:
            present = (
                f'it has no publisher: start {source}, or give its topic, '
                f'-r {topic.name}:=/its/topic'
            )
        elif types:
            present = f'it is published as {", ".join(sorted(types))}'
        else:
            names = ', '.join(sorted({x.node_name for x in publishers}))
            silent = 'sends no more' if before else 'has sent nothing that can be read'
            present = f'its publisher, {names}, {silent}'
        # What is found goes first: a terminal cuts a long line.
        return (
            f'no message on {name} for {missing:.1f} s: {present}; expected '
            f'{topic.type_name}: {topic.content}'
        )


def refusal_status(refusals: RefusalLog, **dropped: int) -> ComponentStatus:
    """Return what was refused, by cause, and what was dropped."""
    return ComponentStatus(
        'messages',
        {
            'refused': sum(refusals.counts.values()),
            **dropped,
            **{f'refused {cause}': count for cause, count in refusals.counts.items()},
        },
    )
