"""Listening to a graph while faults happen in it: what is said, and what the judge needs of it."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
import math
import time
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.faults.judge import Observation, SILENCE
from multicontact_control.experiment.graph.spec import CONTROLLER, SIM
from multicontact_control.experiment.scenario import Setup
from multicontact_control.nodes import qos, topics
from multicontact_control.supervision.fallback import SEVERITY
import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription

CHECKED = (topics.EFFORT_COMMAND, topics.DESIRED_FORCES, topics.ESTIMATED_FORCES,
           topics.NOISE_VARIANCE, topics.TRUE_FORCES)
REMEMBERED = 30_000  # messages per topic: a minute at 500 Hz
SILENT, PAUSED, NONE = 'silent', 'paused', 'none'
Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ReceivedMessage:
    """One named list of efforts, and when it was sent, on the wall clock [s]."""

    time: float
    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class Report:
    """Diagnostics of one node as they came: when [s], and the values of all its parts."""

    time: float
    node: str
    values: dict[str, str]


class GraphWatch:
    """
    Keeps what comes on some topics; nothing happens in between calls of `poll`.

    Parameters
    ----------
    node
        The node that subscribes; no executor may have it.

    """

    def __init__(self, node: Node) -> None:
        self._streams: dict[topics.Topic, Subscription] = {
            topic: node.create_subscription(topic.message, topic.name, _ignore, qos.RECORDING)
            for topic in (*CHECKED, topics.POSE_DESIRED)}
        self._diagnostics = node.create_subscription(
            topics.DIAGNOSTICS.message, topics.DIAGNOSTICS.name, _ignore, qos.RECORDING)
        self.said: dict[topics.Topic, deque[ReceivedMessage]] = {
            topic: deque(maxlen=REMEMBERED) for topic in CHECKED}
        self.reports: deque[Report] = deque(maxlen=1000)
        self.pose: Any = None
        self.polled = math.inf  # everything that was sent until then has been looked for

    def poll(self) -> None:
        """Take in what has come."""
        self.polled = time.time()
        for topic, subscription in self._streams.items():
            for message, sent in _taken(subscription, topic.message):
                if topic is topics.POSE_DESIRED:
                    self.pose = message
                else:
                    self.said[topic].append(ReceivedMessage(
                        sent, dict(zip(message.name, message.effort))))
        for message, sent in _taken(self._diagnostics, topics.DIAGNOSTICS.message):
            if message.status:
                node = message.status[0].name.partition(': ')[0].rsplit('/', 1)[-1]
                self.reports.append(Report(sent, node, {
                    x.key: x.value for status in message.status for x in status.values}))

    def since(self, topic: topics.Topic, start: float) -> list[ReceivedMessage]:
        """Return what was sent on a topic from a time on."""
        found = []
        for said in reversed(self.said[topic]):
            if said.time < start:
                break
            found.append(said)
        return found[::-1]


def _taken(subscription: Subscription, message: Any) -> Iterable[tuple[Any, float]]:
    """Yield what has arrived, with the time when it was sent [s]."""
    handle = subscription.handle
    with handle:
        while (taken := handle.take_message(message, False)) is not None:
            found, info = taken
            yield found, (info['source_timestamp'] or time.time_ns()) * 1e-9


def _ignore(_message: Any) -> None:
    pass


@dataclass(frozen=True)
class Window:
    """When a fault began and ended, and when all was well again [s]; -1 if it never was."""

    begin: float
    end: float
    recovered: float


def observe(
    watch: GraphWatch, setup: Setup, wanted: Mapping[str, float], window: Window,
    problems: Sequence[str] = (),
) -> Observation:
    """
    Return what was seen of a fault on the topics.

    Parameters
    ----------
    watch
        What was said.
    setup
        Joints, rate.
    wanted
        The commanded force per contact [N].
    window
        When the fault was.
    problems
        What is known to have gone wrong already.

    """
    said = {topic: watch.since(topic, window.begin) for topic in CHECKED}
    found = {*problems, *(
        f'{topic.name} not finite' for topic, heard in said.items()
        if topic is not topics.EFFORT_COMMAND  # that is for the judge
        and not all(math.isfinite(x) for message in heard for x in message.values.values()))}
    desired = said[topics.DESIRED_FORCES]
    if any(x.values.get(name, 0.0) > force + 1e-6
           for x in desired for name, force in wanted.items()):
        found.add('obeyed a command it should have refused')
    commands, forces = said[topics.EFFORT_COMMAND], said[topics.TRUE_FORCES]
    joints, rate = setup.controller.robot.joint_names, setup.controller.rate
    samples = np.array([x.time for x in forces])
    silences = _silences(
        [window.begin, *(x.time for x in commands)], samples, watch.polled, rate)
    return Observation(
        torque=np.array([[x.values[name] for name in joints] for x in commands]).reshape(
            -1, len(joints)),
        time=samples - window.begin, force=np.array([max(x.values.values()) for x in forces]),
        reaction=_reaction(desired, silences, window, _told(watch.reports, window), rate),
        silences=[(begin - window.begin, end - window.begin) for begin, end in silences],
        recovered=window.recovered >= 0.0, problems=found)


def _silences(
    edges: list[float], samples: Vector, polled: float, rate: float,
) -> list[Span]:
    """Return from when to when samples came, but no commands, which came at the edges."""
    if samples.size:
        # Samples were looked for after the commands, on a busy machine long after.
        edges = [*edges, min(float(samples[-1]), polled)]
    return [(begin, end) for begin, end in zip(edges, edges[1:])
            if end - begin > SILENCE and np.count_nonzero(
                (samples > begin) & (samples < end)) > 0.5 * (end - begin) * rate]


def _reaction(
    desired: list[ReceivedMessage], silences: list[Span], window: Window, told: Counter[str],
    rate: float,
) -> str:
    """Return the reaction that was told of for longest, or else what was seen."""
    if silences:
        # Who is silent counts no ticks.
        told[SILENT] = round(sum(end - begin for begin, end in silences) * rate)
    if told:
        # Not the strongest: a busy machine adds a few ticks of its own.
        return max(told, key=lambda name: (told[name], (*SEVERITY, SILENT).index(name)))
    # A law that is not at work wants no force, or says nothing of it.
    during = [x for x in desired if x.time < window.end]
    times = [window.begin, *(x.time for x in during), window.end]
    paused = any(not any(x.values.values()) for x in during) or max(np.diff(times)) > SILENCE
    return PAUSED if paused else NONE


def _told(reports: Iterable[Report], window: Window) -> Counter[str]:
    """Return in how many ticks there was each reaction, by the controller's counts."""
    told: Counter[str] = Counter()
    before: dict[str, int] = {}
    for report in reports:
        if report.node != CONTROLLER:
            continue
        counts = {name: int(report.values[key]) for name in SEVERITY[1:]
                  if (key := f'ticks with {name}') in report.values}
        if report.time >= window.begin:
            for name, ticks in counts.items():
                known = before.get(name, 0)
                # Counts that have fallen are those of a new process or activation.
                told[name] += ticks - known if ticks >= known else ticks
        before = counts
        if report.time >= window.end:
            break  # what comes later tells of what came later
    return +told


def busy_share(reports: Iterable[Report], period: float) -> float:
    """
    Return the share of seconds in which the machine was too busy for the control rate.

    That is, in which half of the commands came later than half a period after their samples, as
    the simulator's diagnostics have it.
    """
    latencies = [
        float(text) for report in reports if report.node == SIM
        if (text := report.values.get('latency_us_p50', 'none')) != 'none']
    return float(np.mean(np.array(latencies) > 0.5e6 * period)) if latencies else 0.0
