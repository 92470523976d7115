"""A glance at a running graph, for a progress display."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.guest import GuestNode

LOOP_OF_SIM = f'{topics.SIM}: loop'


@dataclass(frozen=True)
class GraphProgress:
    """
    Where a run is.

    Attributes
    ----------
    time
        Time since the first sample that was seen [s].
    forces
        Measured force per contact [N].
    deadlines, missed
        How many deadlines the simulator has told of, about once a second, and how many of them
        were missed.

    """

    time: float
    forces: Mapping[str, float]
    deadlines: int = 0
    missed: int = 0


class ProgressListener:
    """
    Reads the newest measured forces and reports when asked, and takes no time in between.

    Parameters
    ----------
    domain_id
        ROS domain of the graph.
    namespace
        Namespace of the graph.

    """

    def __init__(self, domain_id: int, namespace: str = '') -> None:
        self._guest = GuestNode('run_progress', domain_id, namespace)
        self._forces, self._reports = (
            self._guest.node.create_subscription(topic.message, topic.name, self._ignore, profile)
            for topic, profile in ((topics.MEASURED_FORCES, qos.GLANCE),
                                   (topics.DIAGNOSTICS, qos.REPORT)))
        self._first: int | None = None
        self._deadlines = self._missed = 0

    def _ignore(self, _message: Any) -> None:
        pass

    def newest(self) -> GraphProgress | None:
        """Return what came last since the last call, if anything."""
        while (report := _take(self._reports, topics.DIAGNOSTICS)) is not None:
            self._count_deadlines(report)
        message = _take(self._forces, topics.MEASURED_FORCES)
        if message is None:
            return None
        stamp = messages.stamp_to_ns(message.header.stamp)
        if self._first is None:
            self._first = stamp
        forces = {
            name: value for name, value in zip(message.name, message.effort)
            if math.isfinite(value)}
        return GraphProgress(
            (stamp - self._first) * 1e-9, forces, self._deadlines, self._missed)

    def _count_deadlines(self, report: Any) -> None:
        for status in report.status:
            if status.name.endswith(LOOP_OF_SIM):
                values = {entry.key: entry.value for entry in status.values}
                self._deadlines = int(values['ticks'])
                self._missed = int(values['deadline_misses_in_all'])

    def close(self) -> None:
        """Leave the graph."""
        self._guest.close()


def _take(subscription: Any, topic: topics.Topic) -> Any:
    """Return the next message that waits for a subscription, None without one."""
    handle = subscription.handle
    with handle:
        taken = handle.take_message(topic.message, False)
    return None if taken is None else taken[0]
