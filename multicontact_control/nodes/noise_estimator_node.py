"""The estimator of the force noise as a ROS 2 node."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
import sys
from typing import Any

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.errors import ConfigError
from multicontact_control.force.noise import Innovation, make_noise_estimator, NoiseEstimator
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.diagnostics import (
    input_status,
    message_status,
    STALE_PERIODS,
    Status,
)
from multicontact_control.nodes.graph_node import (
    create_publisher,
    create_subscription,
    StartupGate,
)
from multicontact_control.nodes.loop_statistics import Freshness, LoopStatistics
from multicontact_control.nodes.managed_node import ACTIVE, ManagedConfig, ManagedNode
from multicontact_control.nodes.messages import InnovationReading, NamedReading
from multicontact_control.nodes.runtime import run_node
import numpy as np
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

MAX_INNOVATIONS = 8


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
        self._inputs: dict[topics.Topic, Subscription] = {}
        self._node_config = ManagedConfig()
        self._watch, self._fresh = LoopStatistics(), Freshness()
        self._samples = 0
        self._forget()

    def configure(self, configurations: Sequence[Any]) -> None:
        """Make the estimator and its ends of the topics."""
        self._config: NoiseEstimatorConfig
        self._config, self._node_config = configurations
        self._names = self._config.contact_names
        estimator = make_noise_estimator(self._config)
        estimator.update(np.zeros(len(self._names)))  # the first one takes a while
        self._estimator, self._watch = estimator, LoopStatistics(self._config.rate)
        self._publisher = create_publisher(self, topics.NOISE_VARIANCE)
        callbacks: dict[topics.Topic, Callable[[Any], None]] = {
            topics.MEASURED_FORCES: self._on_measured}
        if estimator.uses_innovation:
            callbacks[topics.INNOVATION] = self._on_innovation
        self._inputs = {
            topic: create_subscription(self, topic, callback)
            for topic, callback in callbacks.items()}

    def activate(self) -> StartupGate:
        """Start with an empty window."""
        if self._estimator is None:
            raise ConfigError('estimator', 'a configured one', 'none')
        self._estimator.reset()
        self._forget()
        return StartupGate(
            self, {topics.NOISE_VARIANCE: self._publisher}, self._inputs, self._node_config)

    def _forget(self) -> None:
        self._waiting: deque[NamedReading] = deque()
        self._innovations: deque[InnovationReading] = deque(maxlen=MAX_INNOVATIONS)
        self._last_stamp = -1
        self._last_answer: JointState | None = None
        self._fresh.expect(*(topic.name for topic in self._inputs))

    def gate_opened(self) -> None:
        """Answer what waits."""
        self._answer()

    def deactivate(self) -> None:
        """Do nothing more than not to answer."""

    def clean_up(self) -> None:
        """Free the estimator and the topics."""
        if self._publisher is not None:
            self.destroy_publisher(self._publisher)
        for subscription in self._inputs.values():
            self.destroy_subscription(subscription)
        self._estimator = self._publisher = None
        self._inputs = {}

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
        self._node_config.write_counts({
            'samples': self._samples, 'refused': dict(self.refusals.counts)})

    def _on_measured(self, message: Any) -> None:
        if self.state != ACTIVE:
            return
        received = self._fresh.note(topics.MEASURED_FORCES.name)
        self._watch.add_period(received)
        with self.refusals.guard(topics.MEASURED_FORCES):
            self._waiting.append(messages.read_effort(message, self._names))
            if self.working:
                self._answer()
                if not self._waiting:
                    self._watch.add_latency(self._fresh.elapsed(received))

    def _on_innovation(self, message: Any) -> None:
        if self.state != ACTIVE:
            return
        received = self._fresh.note(topics.INNOVATION.name)
        with self.refusals.guard(topics.INNOVATION):
            self._innovations.append(messages.read_innovation(message, self._names))
            if self.working:
                self._answer()
                self._watch.add_latency(self._fresh.elapsed(received))

    def _answer(self) -> None:
        """Answer everything that waits and has all it needs, in order."""
        paired = topics.INNOVATION in self._inputs
        while self._waiting:
            innovation = None
            if paired:
                stamp = self._waiting[0].stamp
                if not self._innovations or self._innovations[-1].stamp < stamp:
                    return
                innovation = self._innovation_of(stamp)
            sample = self._waiting.popleft()
            with self.refusals.guard(topics.MEASURED_FORCES):
                self._answer_one(sample, innovation)

    def _innovation_of(self, stamp: int) -> Innovation | None:
        """Return the innovation of a sample, None if it was lost."""
        for reading in self._innovations:
            if reading.stamp == stamp:
                return reading.innovation
        return None

    def _answer_one(self, sample: NamedReading, innovation: Innovation | None) -> None:
        if self._estimator is None or self._publisher is None:
            return
        if sample.stamp != self._last_stamp:
            if sample.stamp < self._last_stamp:
                self._estimator.reset()
            self._last_stamp = sample.stamp
            self._last_answer = None
            self._samples += 1
            variance = self._estimator.update(sample.values, innovation)
            self._last_answer = messages.joint_state_message(
                sample.stamp, self._names, effort=variance)
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
