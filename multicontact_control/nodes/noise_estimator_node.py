"""The estimator of the force noise as a ROS 2 node."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from functools import partial
import sys
import time
from typing import Any, NamedTuple

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


class ForceSample(NamedTuple):
    """The forces and couples of one sample, each of shape (r,) [N], or whether it was measured."""

    stamp: int  # ns
    forces: Vector
    is_measured: Vector | None  # 0 where the force repeats the last reading; None for 1


class NoiseEstimatorNode(ManagedNode):
    """
    Estimates R_k, the variance of the noise of each measured force, and publishes it.

    A sample that is sent twice gets the same answer twice; one that is older than the last starts
    the window anew. Inactive the node is silent: the controller holds the last R.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(
            topics.ESTIMATOR, NoiseEstimatorConfig, StartupConfig, **options
        )
        self._samples = 0

    def configure(self, configurations: Sequence[Any]) -> None:
        """
        Make the estimator, its publisher of R and its subscriptions; compile its kernels.

        An estimator that works on innovations subscribes to them beside the measured forces.
        """
        self._config, self._node_config = configurations
        names = self._config.contact_names
        zeros = np.zeros(len(names))
        self._estimator = make_noise_estimator(self._config)
        self._estimator.update(zeros)  # the first one takes a while
        self._watch = LoopStatistics(self._config.rate)
        pattern = messages.joint_state_message(0, names, effort=zeros)
        self._publisher = StreamPublisher(self, topics.NOISE_VARIANCE, pattern)
        fields = {topics.MEASURED_FORCES: ['effort']}
        if self._estimator.uses_innovation:
            fields[topics.INNOVATION] = ['position', 'velocity', 'effort']
        self._readers = {}
        for topic in fields:
            optional = ['position'] if topic is topics.MEASURED_FORCES else []
            read = partial(
                messages.read_named_vectors,
                names=names,
                fields=fields[topic],
                optional=optional,
            )
            self._readers[topic] = MessageReader(topic.message, read)
            self.create_subscription(
                topic.message,
                topic.name,
                partial(self._on_message, topic),
                qos.INPUT,
                raw=True,
            )
        self._inputs = InputMonitor(self, self._config.rate, *fields)

    def activate(self) -> StartupConfig:
        """Start with an empty window: samples and innovations from before are forgotten."""
        self._estimator.reset()
        self._waiting: deque[ForceSample] = deque()
        # By stamp [ns], the newest last: those of samples that wait are among the last few.
        self._innovations: deque[tuple[int, Innovation]] = deque(maxlen=8)
        self._last_stamp = -1
        self._last_answer = b''  # empty if the last sample was refused
        self._inputs.restart()
        return self._node_config

    def write_run_counts(self) -> None:
        """Write samples and refusals of this run to `timing_file`, if given."""
        self._node_config.write_counts(
            {'samples': self._samples, 'refused': dict(self.refusals.counts)}
        )

    def _on_message(self, topic: topics.Topic, data: bytes) -> None:
        """Take in forces or an innovation, and answer the samples that are complete with it."""
        received = time.monotonic_ns()
        answered = self._samples
        if topic is topics.MEASURED_FORCES:
            self._watch.add_turn(received)
        if self.state == ACTIVE:
            with self.refusals.logging_refusals(topic):
                self._take_in(topic, data)
                self._inputs.last[topic] = received
                self.do_due_work()
        if self._samples != answered:
            self._watch.latencies.add(time.monotonic_ns() - received)

    def _take_in(self, topic: topics.Topic, data: bytes) -> None:
        stamp, *vectors = self._readers[topic](data)
        if topic is topics.MEASURED_FORCES:
            self._waiting.append(ForceSample(stamp, *vectors))
        else:
            variance, prior_variance, innovation = vectors
            self._innovations.append(
                (stamp, Innovation(innovation, prior_variance, variance))
            )

    def do_due_work(self, _spinner: Spinner | None = None) -> None:
        """
        Answer all samples that wait, in order, up to one whose innovation is still to come.

        An innovation that is lost is not waited for: once that of a later sample has come, the
        sample is answered without one.
        """
        with self.refusals.logging_refusals(topics.MEASURED_FORCES):
            while self.working and self._waiting:
                if self._awaits_innovation(self._waiting[0].stamp):
                    return
                self._answer(self._waiting.popleft())

    def _awaits_innovation(self, stamp: int) -> bool:
        """Return whether no innovation of a sample or of a later one has come."""
        if not self._estimator.uses_innovation:
            return False
        return not self._innovations or self._innovations[-1][0] < stamp

    def _answer(self, sample: ForceSample) -> None:
        """Publish R of a sample; that of the last sample again if it is sent twice."""
        if sample.stamp != self._last_stamp:
            if sample.stamp < self._last_stamp:
                self._estimator.reset()
            self._last_stamp = sample.stamp
            self._last_answer = b''
            self._samples += 1
            innovation = dict(self._innovations).get(sample.stamp)
            measured = sample.is_measured is None or bool(sample.is_measured.all())
            variance = self._estimator.update(
                sample.forces, innovation, measured=measured
            )
            self._last_answer = self._publisher.encode_message(sample.stamp, variance)
        if self._last_answer:
            self._publisher.publish(self._last_answer)

    def collect_statuses(self) -> Iterator[ComponentStatus]:
        """Yield the statuses of loop, inputs and messages, with samples at a bound of R."""
        yield ComponentStatus(
            'loop', {**self._watch.report(), 'samples': self._samples}
        )
        yield self._inputs.status(needed=self.state == ACTIVE)
        at_a_bound = {}
        for name, count in zip(self._config.contact_names, self._estimator.bounded):
            at_a_bound[f'{name} at_a_bound_of_noise_variance'] = int(count)
        yield refusal_status(
            self.refusals, dropped=self._estimator.dropped, **at_a_bound
        )


def main() -> int:
    """Run the noise estimator node in this process; return the exit code, see `run_node`."""
    return run_node(NoiseEstimatorNode)


if __name__ == '__main__':
    sys.exit(main())
