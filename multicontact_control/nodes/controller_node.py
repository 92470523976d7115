"""The controller as a ROS 2 node: samples in, joint torques out."""

from __future__ import annotations

import contextlib
from pathlib import Path
import sys
import time
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig, parameter, read_yaml, Real, validate
from multicontact_control.control.controller import Controller, ControlOutput, Measurement
from multicontact_control.control.reference import (
    CommandedReference,
    ReferenceConfig,
    ReferenceSource,
    ScenarioReference,
)
from multicontact_control.control.sensor.front_end import SensorFrontEnd
from multicontact_control.errors import MulticontactError
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.contact_markers import ContactMarkers
from multicontact_control.nodes.effort_output import EffortOutput
from multicontact_control.nodes.graph_node import (
    create_publisher,
    create_subscription,
    Refusals,
    StartupConfig,
    StartupGate,
)
from multicontact_control.nodes.pairing import PairedSample, SamplePairing
from multicontact_control.nodes.parameters import load_parameters
from multicontact_control.nodes.runtime import run_node, Spinner
from multicontact_control.nodes.timing import DurationLog, write_json
from multicontact_control.paths import config_dir
import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

WORLD_FRAME = 'world'


class ControllerNodeConfig(StartupConfig):
    """What only the node needs to know, not the controller in it."""

    lockstep: bool = parameter(
        False, 'Whether to wait for the noise variance of one sample before answering the next.')
    reference_file: str = parameter(
        '', 'YAML file of a scenario or its reference; empty to obey the command topics.')
    base_dir: str = parameter(
        '', 'Folder that relative paths start from; empty for that of the parameter file.')
    effort_output_topic: str = parameter(
        '', 'Topic for the bare efforts (std_msgs/Float64MultiArray) that the forward '
        'controllers of ros2_control take; empty for none.')
    marker_rate: Real = parameter(
        25.0, 'Contact markers per second; 0 for none.', unit='Hz', ge=0.0)
    marker_scale: Real = parameter(
        0.01, 'Length of the arrow of a contact force.', unit='m/N', gt=0.0)


class ControllerNode(Node):
    """
    Pairs samples, steps the controller, publishes what it answers.

    Without lockstep the newest noise variance is used. A sample that comes again gets the same
    command again; one that is older than the last starts everything anew.
    """

    def __init__(self) -> None:
        super().__init__(topics.CONTROLLER)
        config: ControllerConfig
        node_config: ControllerNodeConfig
        config, node_config = load_parameters(self, ControllerConfig, ControllerNodeConfig)
        self._config, self._node_config = config, node_config
        self._joint_names = config.robot.joint_names
        base_dir = parameter_folder(node_config.base_dir)
        self._commanded: CommandedReference | None = None
        self._controller = Controller.from_config(
            config, self._make_reference(base_dir), base_dir)
        self._refusals = Refusals(self.get_logger())
        self._step_times = DurationLog()
        self._restarts = 0
        self._warm_up()
        self._restart()
        self._outputs = {
            topic: create_publisher(self, topic)
            for topic in topics.published_by(topics.CONTROLLER)}
        self._effort_output = EffortOutput(
            self, self._outputs[topics.EFFORT_COMMAND], node_config.effort_output_topic)
        self._markers = ContactMarkers(
            config, rate=node_config.marker_rate, scale=node_config.marker_scale)
        self._gate = StartupGate(self, self._outputs, self._subscribe(), node_config)

    def _make_reference(self, base_dir: Path) -> ReferenceSource:
        names = self._config.contact_names
        if not self._node_config.reference_file:
            self._commanded = CommandedReference(names)
            return self._commanded
        path = base_dir / self._node_config.reference_file
        values = read_yaml(path)
        # A scenario file holds more than its reference.
        reference = validate(ReferenceConfig, values.get('reference', values), str(path))
        return ScenarioReference(reference, rate=self._config.rate, contact_names=names)

    def _subscribe(self) -> dict[topics.Topic, Subscription]:
        wrench = topics.WRENCH if self._config.wrench_input == 'raw' else topics.WRENCH_FILTERED
        self._wrench_topic = wrench
        callbacks = {
            topics.NOISE_VARIANCE: self._on_noise_variance, wrench: self._on_wrench,
            topics.JOINT_STATES: self._on_joint_states}
        if self._commanded is not None:
            callbacks[topics.FORCE_COMMAND] = self._on_force_command
            callbacks[topics.MOTION_COMMAND] = self._on_motion_command
        return {
            topic: create_subscription(self, topic, callback)
            for topic, callback in callbacks.items()}

    def run(self, spinner: Spinner) -> None:
        """Answer samples until asked to stop."""
        while not spinner.stop:
            spinner.spin_once(0.1 if self._gate.open else 0.01)
            if not self._gate.open and self._gate.poll():
                self._answer()
        spinner.drain()

    def close(self) -> None:
        """Write the counts of this run, if asked to."""
        path = self._node_config.timing_path
        if path is not None:
            write_json(path, {
                'steps': self._step_times.count, 'tick_us': self._step_times.percentiles(),
                'refused': dict(self._refusals.counts), 'unpaired': self._pairing.unpaired,
                'restarts': self._restarts})

    def _warm_up(self) -> None:
        """Take a step that nobody sees: the first one takes a hundred times as long."""
        joints = np.linspace(0.4, 1.0, len(self._joint_names))
        variance = np.full(len(self._config.contact_names), self._config.initial_noise_variance)
        with contextlib.suppress(MulticontactError):
            output = self._controller.step(
                Measurement(time=0.0, q=joints, qd=0.0 * joints, wrench_sensor=np.zeros(6)),
                variance)
            messages.pose_message(
                0, output.pose.position_world, output.pose.quaternion_xyzw, WORLD_FRAME)

    def _restart(self) -> None:
        """Forget the past: the next sample is the first."""
        self._controller.reset()
        self._front_end = SensorFrontEnd(self._config.sensor, self._config.rate)
        self._pairing = SamplePairing()
        self._waiting: PairedSample | None = None
        self._first_stamp = self._last_stamp = -1
        self._last_command: JointState | None = None
        self._variance_stamp = -1
        self._variance: Vector = np.full(
            len(self._config.contact_names), self._config.initial_noise_variance)

    def _on_joint_states(self, message: Any) -> None:
        with self._refusals.guard(topics.JOINT_STATES):
            reading = messages.read_joint_state(message, self._joint_names)
            self._take(self._pairing.add_joints(reading))

    def _on_wrench(self, message: Any) -> None:
        with self._refusals.guard(self._wrench_topic):
            self._take(self._pairing.add_wrench(messages.read_wrench(message)))

    def _on_noise_variance(self, message: Any) -> None:
        with self._refusals.guard(topics.NOISE_VARIANCE):
            reading = messages.read_effort(message, self._config.contact_names)
            if not (reading.values > 0.0).all():
                raise messages.MessageError(
                    'effort', 'variances above 0', reading.values.tolist())
            if reading.stamp > self._last_stamp:
                return  # left over from before a restart
            self._variance_stamp, self._variance = reading.stamp, reading.values
            self._answer()

    def _on_force_command(self, message: Any) -> None:
        with self._refusals.guard(topics.FORCE_COMMAND):
            if self._commanded is not None:
                self._commanded.set_forces(
                    messages.read_some_efforts(message, self._config.contact_names))

    def _on_motion_command(self, message: Any) -> None:
        with self._refusals.guard(topics.MOTION_COMMAND):
            if self._commanded is not None:
                motion = messages.read_motion(message)
                self._commanded.set_motion(
                    motion.position_world, motion.quaternion_xyzw, motion.twist_world,
                    motion.acceleration_world)

    def _take(self, sample: PairedSample | None) -> None:
        if sample is not None:
            self._waiting = sample
            self._answer()

    def _answer(self) -> None:
        """Answer the sample that waits, unless something it needs is not there yet."""
        sample = self._waiting
        if sample is None or not self._gate.open:
            return
        if sample.stamp == self._last_stamp:
            self._waiting = None
            if self._last_command is not None:
                self._effort_output.publish(self._last_command)
            return
        if sample.stamp < self._last_stamp:
            self.get_logger().warning('samples start anew: the controller starts anew')
            self._restart()
            self._restarts += 1
        elif self._node_config.lockstep and self._variance_stamp != self._last_stamp:
            return
        self._waiting = None
        with self._refusals.guard(topics.JOINT_STATES):
            self._step(sample)

    def _step(self, sample: PairedSample) -> None:
        start = time.perf_counter_ns()
        if self._first_stamp < 0:
            self._first_stamp = sample.stamp
        tick = round((sample.stamp - self._first_stamp) * 1e-9 * self._config.rate)
        # Taken note of before the step, so that a sample that cannot be answered is not
        # mistaken for a new start, nor its successor made to wait.
        self._last_stamp, self._last_command = sample.stamp, None
        reading = self._front_end.update(sample.wrench_sensor)
        output = self._controller.step(
            Measurement(time=tick * self._config.period, q=sample.q, qd=sample.qd,
                        wrench_sensor=reading.wrench_sensor), self._variance)
        command = messages.joint_state_message(
            sample.stamp, self._joint_names, effort=output.torque)
        self._step_times.add(time.perf_counter_ns() - start)
        # The command first: everything else can wait, the robot cannot.
        self._effort_output.publish(command)
        self._last_command = command
        self._publish_state(sample.stamp, output)
        if self._markers.due(tick):
            self._outputs[topics.CONTACT_MARKERS].publish(self._markers.message(
                sample.stamp, WORLD_FRAME, output.pose, output.alpha_meas, output.active))

    def _publish_state(self, stamp: int, output: ControlOutput) -> None:
        names = self._config.contact_names
        build, outputs = messages.joint_state_message, self._outputs
        outputs[topics.MEASURED_FORCES].publish(build(stamp, names, effort=output.alpha_meas))
        outputs[topics.ESTIMATED_FORCES].publish(build(
            stamp, names, effort=output.alpha_est, velocity=output.alpha_rate_est))
        outputs[topics.DESIRED_FORCES].publish(build(stamp, names, effort=output.alpha_des))
        outputs[topics.INNOVATION].publish(build(
            stamp, names, position=output.variance_used, velocity=output.prior_variance,
            effort=output.innovation))
        for topic, pose in ((topics.POSE, output.pose), (topics.POSE_DESIRED, output.pose_des)):
            outputs[topic].publish(messages.pose_message(
                stamp, pose.position_world, pose.quaternion_xyzw, WORLD_FRAME))


def parameter_folder(base_dir: str) -> Path:
    """
    Return the folder that relative paths in the parameters start from.

    Parameters
    ----------
    base_dir
        The parameter that says it; if empty, the folder of the last parameter file on the
        command line, and without one that of the package's configuration.

    """
    if base_dir:
        return Path(base_dir)
    files = [
        value for option, value in zip(sys.argv, sys.argv[1:]) if option == '--params-file']
    return Path(files[-1]).resolve().parent if files else config_dir()


def main() -> int:
    """Run the controller node."""
    return run_node(ControllerNode)


if __name__ == '__main__':
    sys.exit(main())
