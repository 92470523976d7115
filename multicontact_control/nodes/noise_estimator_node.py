"""The estimator of the force noise as a ROS 2 node."""

from __future__ import annotations

from collections import deque
import sys
from typing import Any

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.force.noise import Innovation, make_noise_estimator
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph_node import (
    create_publisher,
    create_subscription,
    Refusals,
    StartupConfig,
    StartupGate,
)
from multicontact_control.nodes.messages import InnovationReading, NamedReading
from multicontact_control.nodes.parameters import load_parameters
from multicontact_control.nodes.runtime import run_node, Spinner
from multicontact_control.nodes.timing import write_json
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

MAX_INNOVATIONS = 8


class NoiseEstimatorNode(Node):
    """
    Publishes R_k for every measured force.

    A sample that comes again gets the same answer again; one that is older than the last starts
    the window anew.
    """

    def __init__(self) -> None:
        super().__init__(topics.ESTIMATOR)
        config: NoiseEstimatorConfig
        startup: StartupConfig
        config, startup = load_parameters(self, NoiseEstimatorConfig, StartupConfig)
        self._names = config.contact_names
        self._timing_path = startup.timing_path
        self._estimator = make_noise_estimator(config)
        self._estimator.update(np.zeros(len(self._names)))  # the first one takes a while
        self._estimator.reset()
        self._refusals = Refusals(self.get_logger())
        self._waiting: deque[NamedReading] = deque()
        self._last_stamp = -1
        self._last_answer: JointState | None = None
        self._samples = 0
        self._publisher = create_publisher(self, topics.NOISE_VARIANCE)
        self._innovations: deque[InnovationReading] = deque(maxlen=MAX_INNOVATIONS)
        callbacks = {topics.MEASURED_FORCES: self._on_measured}
        if self._estimator.uses_innovation:
            callbacks[topics.INNOVATION] = self._on_innovation
        subscriptions = {
            topic: create_subscription(self, topic, callback)
            for topic, callback in callbacks.items()}
        self._gate = StartupGate(
            self, {topics.NOISE_VARIANCE: self._publisher}, subscriptions, startup)

    def run(self, spinner: Spinner) -> None:
        """Answer samples until asked to stop."""
        while not spinner.stop:
            spinner.spin_once(0.1 if self._gate.open else 0.01)
            if not self._gate.open and self._gate.poll():
                self._answer()
        spinner.drain()

    def close(self) -> None:
        """Write the counts of this run, if asked to."""
        if self._timing_path is not None:
            write_json(self._timing_path, {
                'samples': self._samples, 'refused': dict(self._refusals.counts)})

    def _on_measured(self, message: Any) -> None:
        with self._refusals.guard(topics.MEASURED_FORCES):
            self._waiting.append(messages.read_effort(message, self._names))
            if self._gate.open:
                self._answer()

    def _on_innovation(self, message: Any) -> None:
        with self._refusals.guard(topics.INNOVATION):
            self._innovations.append(messages.read_innovation(message, self._names))
            if self._gate.open:
                self._answer()

    def _answer(self) -> None:
        """Answer everything that waits and has all it needs, in order."""
        while self._waiting:
            innovation = None
            if self._estimator.uses_innovation:
                stamp = self._waiting[0].stamp
                if not self._innovations or self._innovations[-1].stamp < stamp:
                    return
                innovation = self._innovation_of(stamp)
            sample = self._waiting.popleft()
            with self._refusals.guard(topics.MEASURED_FORCES):
                self._answer_one(sample, innovation)

    def _innovation_of(self, stamp: int) -> Innovation | None:
        """Return the innovation of a sample, None if it was lost."""
        for reading in self._innovations:
            if reading.stamp == stamp:
                return reading.innovation
        return None

    def _answer_one(self, sample: NamedReading, innovation: Innovation | None) -> None:
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


def main() -> int:
    """Run the noise estimator node."""
    return run_node(NoiseEstimatorNode)


if __name__ == '__main__':
    sys.exit(main())
