"""The estimator of the force noise as a ROS 2 node."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import sys
import time
from typing import Any

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.errors import ConfigError
from multicontact_control.force.noise import make_noise_estimator, NoiseEstimator
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.diagnostics import (
    input_status,
    message_status,
    STALE_PERIODS,
    Status,
)
from multicontact_control.nodes.graph_node import StartupGate
from multicontact_control.nodes.loop_statistics import Freshness, LoopStatistics
from multicontact_control.nodes.managed_node import ACTIVE, ManagedConfig, ManagedNode
from multicontact_control.nodes.runtime import run_node
from multicontact_control.nodes.streams import (
    effort_reader,
    innovation_reader,
    InnovationReading,
    MessageReader,
    NamedReading,
)
import numpy as np

MAX_INNOVATIONS = 8


class NoiseEstimatorNode(ManagedNode):
    """
    Publishes R_k for every measured force.

    A sample that comes again gets the same answer again; one that is older than the last starts
    the window anew. Inactive it is silent, and whoever needs R holds the last one.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.ESTIMATOR, NoiseEstimatorConfig, ManagedConfig, **options)
        self._estimator: NoiseEstimator | None = None
        self._measured, self._innovation = effort_reader(()), innovation_reader(())
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
        self._measured = effort_reader(self._names)
        self._innovation = innovation_reader(self._names)
        self.streams.advertise(
            {topics.NOISE_VARIANCE: messages.joint_state_message(
                0, self._names, effort=np.zeros(len(self._names)))})
        self.streams.subscribe(topics.MEASURED_FORCES, self._on_measured, qos.INPUT)
        if estimator.uses_innovation:
            self.streams.subscribe(topics.INNOVATION, self._on_innovation, qos.INPUT)

    def activate(self) -> StartupGate:
        """Start with an empty window."""
        if self._estimator is None:
            raise ConfigError('estimator', 'a configured one', 'none')
        self._estimator.reset()
        self._forget()
        return StartupGate(
            self, self.streams.publishers, self.streams.subscriptions, self._node_config)

    def _forget(self) -> None:
        self._waiting: deque[NamedReading] = deque()
        self._innovations: deque[InnovationReading] = deque(maxlen=MAX_INNOVATIONS)
        self._last_stamp = -1
        self._last_answer = b''
        self._fresh.expect(*(topic.name for topic in self.streams.subscriptions))

    def gate_opened(self) -> None:
        """Answer what waits."""
        self._answer()

    def clean_up(self) -> None:
        """Free the estimator."""
        self._estimator = None

    def close(self) -> None:
        """Write the counts of this run, if asked to."""
        self._node_config.write_counts({
            'samples': self._samples, 'refused': dict(self.refusals.counts)})

    def _on_measured(self, data: bytes) -> None:
        self._watch.add_period(time.monotonic_ns())
        self._receive(topics.MEASURED_FORCES, self._measured, self._waiting, data)

    def _on_innovation(self, data: bytes) -> None:
        self._receive(topics.INNOVATION, self._innovation, self._innovations, data)

    def _receive(
        self, topic: topics.Topic, reader: MessageReader[Any], queue: deque[Any], data: bytes,
    ) -> None:
        """Take in a message; answer what can be answered with it."""
        if self.state != ACTIVE:
            return
        received, answered = time.monotonic_ns(), self._samples
        with self.refusals.guard(topic):
            queue.append(reader.read(data))
            self._fresh.note(topic.name)
            if self.working:
                self._answer()
        if self._samples != answered:
            self._watch.add_latency(time.monotonic_ns() - received)

    def _answer(self) -> None:
        """Answer everything that waits and has all it needs, in order."""
        paired = topics.INNOVATION in self.streams.subscriptions
        while self._waiting:
            stamp = self._waiting[0].stamp
            if paired and (not self._innovations or self._innovations[-1].stamp < stamp):
                return
            # None if it was lost, too.
            innovation = next(
                (x.innovation for x in self._innovations if x.stamp == stamp), None)
            sample = self._waiting.popleft()
            if stamp != self._last_stamp and self._estimator is not None:
                if stamp < self._last_stamp:
                    self._estimator.reset()
                self._last_stamp, self._last_answer = stamp, b''
                self._samples += 1
                variance = self._estimator.update(sample.values, innovation)
                self._last_answer = self.streams.message(topics.NOISE_VARIANCE, stamp, variance)
            if self._last_answer:
                self.streams.pass_on(topics.NOISE_VARIANCE, self._last_answer)

    def statuses(self) -> list[Status]:
        """Return what diagnostics report."""
        dropped = self._estimator.dropped if self._estimator is not None else 0
        return [
            Status('loop', {**self._watch.report(), 'samples': self._samples}),
            input_status(self._fresh, STALE_PERIODS / self._config.rate,
                         needed=self.state == ACTIVE),
            message_status(self.refusals, dropped=dropped,
                           slow=self._measured.slow + self._innovation.slow)]


def main() -> int:
    """Run the noise estimator node."""
    return run_node(NoiseEstimatorNode)


if __name__ == '__main__':
    sys.exit(main())
