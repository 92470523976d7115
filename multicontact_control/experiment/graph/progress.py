"""A glance at a running graph, for a progress display."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph_node import ignore, take
from multicontact_control.nodes.link import GuestNode

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


class ProgressListener(GuestNode):
    """Reads the newest measured forces and reports when asked, and takes no time in between."""

    def __init__(self, domain_id: int, namespace: str = '') -> None:
        super().__init__('run_progress', domain_id, namespace)
        self._forces, self._reports = (
            self.node.create_subscription(topic.message, topic.name, ignore, profile)
            for topic, profile in ((topics.MEASURED_FORCES, qos.GLANCE),
                                   (topics.DIAGNOSTICS, qos.REPORT)))
        self._first: int | None = None
        self._deadlines = self._missed = 0

    @property
    def heard(self) -> bool:
        """Whether anything has come yet."""
        return self._first is not None

    def newest(self) -> GraphProgress | None:
        """Return what came last since the last call, if anything."""
        while (report := take(self._reports)) is not None:
            self._count_deadlines(report[0])
        taken = take(self._forces)
        if taken is None:
            return None
        message = taken[0]
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
