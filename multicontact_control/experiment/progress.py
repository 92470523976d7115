"""A glance at a running graph, for a progress display."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.runtime import prepare_environment
from rclpy.context import Context
from rclpy.node import Node


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

    """

    time: float
    forces: Mapping[str, float]


class ProgressListener:
    """
    Reads the newest measured forces when asked, and takes no time in between.

    Parameters
    ----------
    domain_id
        ROS domain of the graph.
    namespace
        Namespace of the graph.

    """

    def __init__(self, domain_id: int, namespace: str = '') -> None:
        prepare_environment()
        self._context = Context()
        self._context.init(args=[], domain_id=domain_id)
        self._node = Node(
            'run_progress', namespace=namespace, context=self._context, use_global_arguments=False,
            start_parameter_services=False, enable_rosout=False)
        self._subscription = self._node.create_subscription(
            topics.MEASURED_FORCES.message, topics.MEASURED_FORCES.name, self._ignore, qos.GLANCE)
        self._first: int | None = None

    def _ignore(self, _message: Any) -> None:
        pass

    def newest(self) -> GraphProgress | None:
        """Return what came last since the last call, if anything."""
        handle = self._subscription.handle
        with handle:
            taken = handle.take_message(topics.MEASURED_FORCES.message, False)
        if taken is None:
            return None
        message = taken[0]
        stamp = messages.stamp_to_ns(message.header.stamp)
        if self._first is None:
            self._first = stamp
        forces = {
            name: value for name, value in zip(message.name, message.effort)
            if math.isfinite(value)}
        return GraphProgress((stamp - self._first) * 1e-9, forces)

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        self._context.try_shutdown()
