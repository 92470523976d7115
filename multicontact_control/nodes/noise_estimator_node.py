"""The estimator of the force noise as a ROS 2 node."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from functools import partial
import sys
import time
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.force.noise import Innovation, make_noise_estimator
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.diagnostics import (
    ComponentStatus,
    InputMonitor,
    LoopStatistics,
    refusal_status,
)
from multicontact_control.nodes.graph import StartupConfig
from multicontact_control.nodes.lifecycle import ACTIVE, ManagedNode
from multicontact_control.nodes.runtime import run_node, Spinner
from multicontact_control.nodes.streams import MessageReader, StreamPublisher
import numpy as np


class NoiseEstimatorNode(ManagedNode):
    """
    Estimates R_k, the variance of the noise of each measured force, and publishes it.

    A sample that comes again gets the same answer again; one that is older than the last starts
    the window anew. Inactive it is silent: the controller holds the last R.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(
            topics.ESTIMATOR, NoiseEstimatorConfig, StartupConfig, **options
        )
        self._samples = 0

    def configure(self, configurations: Sequence[Any]) -> None:
        """Make the estimator and its ends of the topics."""
        self._config, self._node_config = configurations
        names = self._config.contact_names
        self._estimator = make_noise_estimator(self._config)
        self._estimator.update(np.zeros(len(names)))  # the first one takes a while
        self._watch = LoopStatistics(self._config.rate)
        self._publisher = StreamPublisher(
            self,
            topics.NOISE_VARIANCE,
            (messages.joint_state_message(0, names, effort=np.zeros(len(names)))),
        )
        heard = [topics.MEASURED_FORCES, topics.INNOVATION][
            : 1 + self._estimator.uses_innovation
        ]
        self._readers = {
            topic: MessageReader(
                topic.message,
                partial(messages.read_named_vectors, names=names, fields=fields),
            )
            for topic, fields in zip(
                heard, (['effort'], ['position', 'velocity', 'effort'])
            )
        }
        for topic in heard:
            self.create_subscription(
                topic.message,
                topic.name,
                partial(self._on_message, topic),
                qos.INPUT,
                raw=True,
            )
        self._inputs = InputMonitor(self, self._config.rate, *heard)

    def activate(self) -> StartupConfig:
        """Start with an empty window."""
        self._estimator.reset()
        self._waiting: deque[tuple[int, Vector]] = deque()
        self._innovations: deque[tuple[int, Innovation]] = deque(maxlen=8)
        self._last_stamp, self._last_answer = -1, b''
        self._inputs.restart()
        return self._node_config

    def write_run_counts(self) -> None:
        """Write the counts of this run, if asked to."""
        self._node_config.write_counts(
            {'samples': self._samples, 'refused': dict(self.refusals.counts)}
        )

    def _on_message(self, topic: topics.Topic, data: bytes) -> None:
        """Take in a message; answer what can be answered with it."""
        received, answered = time.monotonic_ns(), self._samples
        if topic is topics.MEASURED_FORCES:
            self._watch.add_period(received)
        if self.state == ACTIVE:
            with self.refusals.logging_refusals(topic):
                stamp, *vectors = self._readers[topic](data)
                if topic is topics.MEASURED_FORCES:
                    self._waiting.append((stamp, vectors[0]))
                else:
                    variance, prior, innovation = vectors
                    self._innovations.append(
                        (stamp, Innovation(innovation, prior, variance))
                    )
                self._inputs.last[topic] = received
                self.do_due_work()
        if self._samples != answered:
            self._watch.latencies.add(time.monotonic_ns() - received)

    def do_due_work(self, _spinner: Spinner | None = None) -> None:
        """Answer everything that waits, in order; an innovation that is lost is not waited for."""
        with self.refusals.logging_refusals(topics.MEASURED_FORCES):
            while self.working and self._waiting:
                stamp, values = self._waiting[0]
                if self._estimator.uses_innovation and (
                    not self._innovations or self._innovations[-1][0] < stamp
                ):
                    return
                self._waiting.popleft()
                if stamp != self._last_stamp:
                    if stamp < self._last_stamp:
                        self._estimator.reset()
                    self._last_stamp, self._last_answer = stamp, b''
                    self._samples += 1
                    self._last_answer = self._publisher.encode_message(
                        stamp,
                        self._estimator.update(
                            values, dict(self._innovations).get(stamp)
                        ),
                    )
                if self._last_answer:
                    self._publisher.publish(self._last_answer)

    def collect_statuses(self) -> Iterator[ComponentStatus]:
        """Yield what diagnostics report."""
        yield ComponentStatus(
            'loop', {**self._watch.report(), 'samples': self._samples}
        )
        yield self._inputs.status(needed=self.state == ACTIVE)
        yield refusal_status(
            self.refusals,
            dropped=self._estimator.dropped,
            **{
                f'{name} at_a_bound_of_noise_variance': int(count)
                for name, count in zip(
                    self._config.contact_names, self._estimator.bounded
                )
            },
        )


def main() -> int:
    """Run the noise estimator node."""
    return run_node(NoiseEstimatorNode)


if __name__ == '__main__':
    sys.exit(main())
