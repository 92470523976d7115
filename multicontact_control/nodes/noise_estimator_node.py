"""The estimator of the force noise as a ROS 2 node."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import sys
from typing import Any

import numpy as np
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.errors import ConfigError
from multicontact_control.force.noise import make_noise_estimator, NoiseEstimator
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.diagnostics import input_status, message_status, Status
from multicontact_control.nodes.graph_node import (
    create_publisher,
    create_subscription,
    StartupGate,
)
from multicontact_control.nodes.loop_watch import Freshness, LoopWatch
from multicontact_control.nodes.managed_node import ACTIVE, ManagedConfig, ManagedNode
from multicontact_control.nodes.messages import NamedReading
from multicontact_control.nodes.runtime import run_node
from multicontact_control.nodes.timing import write_json

STALE_PERIODS = 25


class NoiseEstimatorNode(ManagedNode):
    """
    Publishes R_k for every measured force.

    A sample that comes again gets the same answer again; one that is older than the last starts
    the window anew. Inactive it is silent, and whoever needs R holds the last one.
    """

    def __init__(self) -> None:
        super().__init__(topics.ESTIMATOR, NoiseEstimatorConfig, ManagedConfig)
        self._estimator: NoiseEstimator | None = None
        self._publisher: Publisher | None = None
        self._subscription: Subscription | None = None
        self._node_config = ManagedConfig()
        self._watch, self._fresh = LoopWatch(), Freshness()
        self._samples = 0
        self._forget()

    def configure(self, configurations: Sequence[Any]) -> None:
        """Make the estimator and its ends of the topics."""
        self._config: NoiseEstimatorConfig
        self._config, self._node_config = configurations
        self._names = self._config.contact_names
        estimator = make_noise_estimator(self._config)
        estimator.update(np.zeros(len(self._names)))  # the first one takes a while
        self._estimator, self._watch = estimator, LoopWatch(self._config.rate)
        self._publisher = create_publisher(self, topics.NOISE_VARIANCE)
        self._subscription = create_subscription(
            self, topics.MEASURED_FORCES, self._on_measured)

    def activate(self) -> StartupGate:
        """Start with an empty window."""
        if self._estimator is None:
            raise ConfigError('estimator', 'a configured one', 'none')
        self._estimator.reset()
        self._forget()
        return StartupGate(
            self, {topics.NOISE_VARIANCE: self._publisher},
            {topics.MEASURED_FORCES: self._subscription}, self._node_config)

    def _forget(self) -> None:
        self._waiting: deque[NamedReading] = deque()
        self._last_stamp = -1
        self._last_answer: JointState | None = None
        self._fresh.expect(topics.MEASURED_FORCES.name)

    def gate_opened(self) -> None:
        """Answer what waits."""
        self._answer()

    def deactivate(self) -> None:
        """Do nothing more than not to answer."""

    def clean_up(self) -> None:
        """Free the estimator and the topics."""
        if self._publisher is not None:
            self.destroy_publisher(self._publisher)
        if self._subscription is not None:
            self.destroy_subscription(self._subscription)
        self._estimator = self._publisher = self._subscription = None

    def check(self, configurations: Sequence[Any]) -> None:
        """Take every valid configuration."""

    def reconfigure(self, configurations: Sequence[Any]) -> None:
        """Go on with an empty window, if what the estimator depends on has changed."""
        config, self._node_config = configurations
        if config != self._config:
            self._config = config
            self._estimator = make_noise_estimator(config)

    def close(self) -> None:
        """Write the counts of this run, if asked to."""
        path = self._node_config.timing_path
        if path is not None:
            write_json(path, {
                'samples': self._samples, 'refused': dict(self.refusals.counts)})

    def _on_measured(self, message: Any) -> None:
        if self.state != ACTIVE:
            return
        received = self._fresh.note(topics.MEASURED_FORCES.name)
        self._watch.beat(received)
        with self.refusals.guard(topics.MEASURED_FORCES):
            self._waiting.append(messages.read_effort(message, self._names))
            if self.working:
                self._answer()
                self._watch.answered(self._fresh.elapsed(received))

    def _answer(self) -> None:
        """Answer everything that waits, in order."""
        while self._waiting:
            sample = self._waiting.popleft()
            with self.refusals.guard(topics.MEASURED_FORCES):
                self._answer_one(sample)

    def _answer_one(self, sample: NamedReading) -> None:
        if self._estimator is None or self._publisher is None:
            return
        if sample.stamp != self._last_stamp:
            if sample.stamp < self._last_stamp:
                self._estimator.reset()
            self._last_stamp = sample.stamp
            self._last_answer = None
            self._samples += 1
            self._last_answer = messages.joint_state_message(
                sample.stamp, self._names, effort=self._estimator.update(sample.values))
        if self._last_answer is not None:
            self._publisher.publish(self._last_answer)

    def statuses(self) -> list[Status]:
        """Return what diagnostics report."""
        dropped = self._estimator.dropped if self._estimator is not None else 0
        return [
            Status('loop', {**self._watch.report(), 'samples': self._samples}),
            input_status(self._fresh, STALE_PERIODS / self._config.rate,
                         needed=self.state == ACTIVE),
            message_status(self.refusals, dropped=dropped)]


def main() -> int:
    """Run the noise estimator node."""
    return run_node(NoiseEstimatorNode)


if __name__ == '__main__':
    sys.exit(main())
