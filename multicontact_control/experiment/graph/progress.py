"""A glance at a running graph, for a progress display."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
import time

from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph import ignore, take
from multicontact_control.nodes.link import GuestNode


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
    realtime_factor
        Simulated time over wall time since then.

    """

    time: float
    forces: Mapping[str, float]
    realtime_factor: float = 0.0


class ProgressListener(GuestNode):
    """Reads the newest measured forces and reports when asked, and takes no time in between."""

    def __init__(self, domain_id: int, namespace: str = '') -> None:
        super().__init__('run_progress', domain_id, namespace)
        self._forces, self._variances = (
            self.node.create_subscription(topic.message, topic.name, ignore, qos.GLANCE)
            for topic in (topics.MEASURED_FORCES, topics.NOISE_VARIANCE))
        self._first: int | None = None
        self._newest = 0
        self._start = 0.0

    @property
    def heard(self) -> bool:
        """Whether anything has come yet."""
        return self._first is not None

    def newest(self) -> GraphProgress | None:
        """Return what came last since the last call, if anything."""
        taken = take(self._forces)
        if taken is None:
            return None
        message = taken[0]
        stamp = messages.stamp_to_ns(message.header.stamp)
        if self._first is None:
            self._first, self._start = stamp, time.monotonic()
        self._newest = stamp
        forces = {
            name: value for name, value in zip(message.name, message.effort)
            if math.isfinite(value)}
        simulated, wall = (stamp - self._first) * 1e-9, time.monotonic() - self._start
        return GraphProgress(simulated, forces, simulated / wall if wall else 0.0)

    def waited_for(self) -> str:
        """Return which node the others wait for, by the stamps of what each sent last."""
        self.newest()
        taken = take(self._variances)
        behind = taken is None or messages.stamp_to_ns(taken[0].header.stamp) < self._newest
        return topics.ESTIMATOR if behind else topics.CONTROLLER
