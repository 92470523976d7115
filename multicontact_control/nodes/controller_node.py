"""The controller as a ROS 2 node: samples in, joint torques out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from pathlib import Path
import sys
import time
from typing import Any

from multicontact_control.config import ControllerConfig, parameter, read_yaml, Real, validate
from multicontact_control.control.command_limits import CommandLimits
from multicontact_control.control.controller import ControlOutput
from multicontact_control.control.reference import ReferenceConfig, ScenarioReference
from multicontact_control.control.sensor.tare import TareConfig
from multicontact_control.errors import MulticontactError
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.command_interface import CommandInterface
from multicontact_control.nodes.contact_markers import ContactMarkers
from multicontact_control.nodes.control_session import ControlSession
from multicontact_control.nodes.diagnostics import input_status, message_status, Status
from multicontact_control.nodes.effort_output import EffortOutput
from multicontact_control.nodes.graph_node import (
    create_publisher,
    create_subscription,
    StartupGate,
)
from multicontact_control.nodes.loop_watch import Freshness, LoopWatch
from multicontact_control.nodes.managed_node import ACTIVE, ManagedConfig, ManagedNode
from multicontact_control.nodes.pairing import PairedSample, SamplePairing
from multicontact_control.nodes.runtime import run_node
from multicontact_control.nodes.timing import DurationLog, write_json
from multicontact_control.paths import config_dir
import numpy as np
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

WORLD_FRAME = 'world'
STALE_PERIODS = 25


class ControllerNodeConfig(ManagedConfig):
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
    command: CommandLimits = CommandLimits()
    tare: TareConfig = TareConfig()


class ControllerNode(ManagedNode):
    """
    Pairs samples, steps the controller, publishes what it answers.

    Without lockstep the newest noise variance is used, however old: if the estimator has died,
    its last word is held, and diagnostics say so. A sample that comes again gets the same
    command again; one that is older than the last starts everything anew. After a deactivation
    samples are answered by the declared safe behaviour.
    """

    def __init__(self) -> None:
        super().__init__(topics.CONTROLLER, ControllerConfig, ControllerNodeConfig)
        self._session: ControlSession | None = None
        self._commands: CommandInterface | None = None
        self._effort_output: EffortOutput | None = None
        self._markers: ContactMarkers | None = None
        self._outputs: dict[topics.Topic, Publisher] = {}
        self._inputs: dict[topics.Topic, Subscription] = {}
        self._node_config = ControllerNodeConfig()
        self._watch, self._fresh = LoopWatch(), Freshness()
        self._pairing = SamplePairing()
        self._step_times = DurationLog()
        self._restarts = 0
        self._waiting: PairedSample | None = None
        self._received = 0
        self._last_command: JointState | None = None
        self._is_safe = False

    def configure(self, configurations: Sequence[Any]) -> None:
        """Build the controller and its ends of the topics."""
        config: ControllerConfig
        config, self._node_config = configurations
        base_dir = parameter_folder(self._node_config.base_dir)
        session = ControlSession(
            config, self._scenario(config, base_dir), self._node_config.command, base_dir)
        warm_up(session)
        self._session, self._watch = session, LoopWatch(config.rate)
        self._outputs = {
            topic: create_publisher(self, topic)
            for topic in topics.published_by(topics.CONTROLLER)}
        self._effort_output = EffortOutput(
            self, self._outputs[topics.EFFORT_COMMAND], self._node_config.effort_output_topic)
        self._markers = ContactMarkers(
            config, rate=self._node_config.marker_rate, scale=self._node_config.marker_scale)
        self._wrench = topics.WRENCH if config.wrench_input == 'raw' else topics.WRENCH_FILTERED
        callbacks: dict[topics.Topic, Callable[[Any], None]] = {
            topics.NOISE_VARIANCE: self._on_noise_variance, self._wrench: self._on_wrench,
            topics.JOINT_STATES: self._on_joint_states}
        self._inputs = {
            topic: create_subscription(self, topic, callback)
            for topic, callback in callbacks.items()}
        self._commands = CommandInterface(
            self, session, self.refusals,
            lambda bias: self.parameter_set.assign('tool.bias_sensor', bias))
        self._commands.tare_config = self._node_config.tare
        self._forget()

    def _scenario(self, config: ControllerConfig, base_dir: Path) -> ScenarioReference | None:
        if not self._node_config.reference_file:
            return None
        path = base_dir / self._node_config.reference_file
        values = read_yaml(path)
        # A scenario file holds more than its reference.
        reference = validate(ReferenceConfig, values.get('reference', values), str(path))
        return ScenarioReference(
            reference, rate=config.rate, contact_names=config.contact_names)

    def activate(self) -> StartupGate:
        """Start with the next sample, as if there had been none."""
        self._configured.restart()
        self._forget()
        commands = self._commands.subscriptions if self._commands else {}
        return StartupGate(self, self._outputs, {**self._inputs, **commands}, self._node_config)

    def gate_opened(self) -> None:
        """Answer the sample that waits."""
        self._answer()

    def deactivate(self) -> None:
        """Go over to the safe behaviour."""
        self._is_safe, self._last_command = True, None
        kind = self._configured.config.safe_behaviour.kind.replace('_', ' ')
        self.get_logger().info(f'deactivated: commanding {kind} from the next sample on')

    def clean_up(self) -> None:
        """Free the controller and the topics."""
        if self._commands is not None:
            self._commands.close()
        if self._effort_output is not None:
            self._effort_output.close()
        for publisher in self._outputs.values():
            self.destroy_publisher(publisher)
        for subscription in self._inputs.values():
            self.destroy_subscription(subscription)
        self._session = self._commands = self._effort_output = self._markers = None
        self._outputs, self._inputs = {}, {}
        self._is_safe = False

    def check(self, configurations: Sequence[Any]) -> None:
        """Raise if the controller cannot go on with new configurations."""
        self._configured.controller.check(configurations[0])

    def reconfigure(self, configurations: Sequence[Any]) -> None:
        """Go on with new configurations from the next sample on."""
        session = self._configured
        config, self._node_config = configurations
        session.limits = self._node_config.command
        if config != session.config:
            session.controller.reconfigure(config)

    @property
    def _configured(self) -> ControlSession:
        if self._session is None:
            raise MulticontactError('the controller is not configured')
        return self._session

    def close(self) -> None:
        """Write the counts of this run, if asked to."""
        path = self._node_config.timing_path
        if path is not None:
            write_json(path, {
                'steps': self._step_times.count, 'tick_us': self._step_times.percentiles(),
                'refused': dict(self.refusals.counts), 'unpaired': self._pairing.unpaired,
                'restarts': self._restarts})

    def _forget(self) -> None:
        self._last_command = None
        self._is_safe = False
        if not self._node_config.lockstep:
            self._waiting = None  # it may be old; in lockstep nothing is
        self._fresh.expect(*(topic.name for topic in self._inputs))

    def _on_joint_states(self, message: Any) -> None:
        session = self._session
        if session is None:
            return
        self._received = self._fresh.note(topics.JOINT_STATES.name)
        with self.refusals.guard(topics.JOINT_STATES):
            self._take(self._pairing.add_joints(messages.read_joint_state(
                message, session.config.robot.joint_names, with_effort=session.first_stamp < 0)))

    def _on_wrench(self, message: Any) -> None:
        self._received = self._fresh.note(self._wrench.name)
        with self.refusals.guard(self._wrench):
            self._take(self._pairing.add_wrench(messages.read_wrench(message)))

    def _on_noise_variance(self, message: Any) -> None:
        session = self._session
        if session is None:
            return
        self._fresh.note(topics.NOISE_VARIANCE.name)
        with self.refusals.guard(topics.NOISE_VARIANCE):
            reading = messages.read_effort(message, session.config.contact_names)
            if not (reading.values > 0.0).all():
                raise messages.MessageError(
                    'effort', 'variances above 0', reading.values.tolist())
            if reading.stamp > session.last_stamp:
                return  # left over from before a restart
            session.variance_stamp, session.variance = reading.stamp, reading.values
            self._answer()

    def _take(self, sample: PairedSample | None) -> None:
        if sample is not None:
            self._watch.beat(self._received)
            self._waiting = sample
            self._answer()

    def _answer(self) -> None:
        """Answer the sample that waits, unless something it needs is not there yet."""
        sample, session = self._waiting, self._session
        if sample is None or session is None or not (self.working or self._is_safe):
            return
        if sample.stamp == session.last_stamp:
            self._waiting = None
            if self._last_command is not None:
                self._send(self._last_command)
            return
        if sample.stamp < session.last_stamp:
            self.get_logger().warning('samples start anew: the controller starts anew')
            session.restart()
            self._restarts += 1
        elif self._node_config.lockstep and not self._is_safe and (
                session.variance_stamp != session.last_stamp):
            return
        self._waiting = None
        with self.refusals.guard(topics.JOINT_STATES):
            self._step(session, sample)

    def _step(self, session: ControlSession, sample: PairedSample) -> None:
        start = time.perf_counter_ns()
        self._last_command = None
        output = None if self._is_safe else session.step(sample)
        torque = session.safe_step(sample) if output is None else output.torque
        command = messages.joint_state_message(
            sample.stamp, session.config.robot.joint_names, effort=torque)
        self._step_times.add(time.perf_counter_ns() - start)
        # The command first: everything else can wait, the robot cannot.
        self._send(command)
        self._watch.answered(time.monotonic_ns() - self._received)
        self._last_command = command
        if output is not None:
            self._publish_state(sample.stamp, session.config.contact_names, output)
            self._publish_markers(sample.stamp, session.tick, output)

    def _send(self, command: JointState) -> None:
        if self._effort_output is not None:
            self._effort_output.publish(command)

    def _publish_state(
        self, stamp: int, names: tuple[str, ...], output: ControlOutput,
    ) -> None:
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

    def _publish_markers(self, stamp: int, tick: int, output: ControlOutput) -> None:
        if self._markers is not None and self._markers.due(tick):
            self._outputs[topics.CONTACT_MARKERS].publish(self._markers.message(
                stamp, WORLD_FRAME, output.pose, output.alpha_meas, output.active))

    def statuses(self) -> list[Status]:
        """Return what diagnostics report."""
        session = self._configured
        self._watch.missed, session.skipped = session.skipped, 0
        loop = {**self._watch.report(), 'steps': self._step_times.count,
                'restarts': self._restarts, 'safe_behaviour': self._is_safe}
        missed = loop['deadline_misses']
        return [
            Status('loop', loop, warning=f'{missed} samples without a command' if missed else ''),
            input_status(self._fresh, STALE_PERIODS * session.config.period,
                         needed=self.state == ACTIVE,
                         consequence=': the last R is held' if self._is_variance_stale else ''),
            Status('contacts', _contact_values(session)),
            message_status(self.refusals, unpaired=self._pairing.unpaired)]

    @property
    def _is_variance_stale(self) -> bool:
        age = self._fresh.ages().get(topics.NOISE_VARIANCE.name)
        return age is None or age > STALE_PERIODS * self._configured.config.period


def _contact_values(session: ControlSession) -> dict[str, Any]:
    output = session.output
    values: dict[str, Any] = {'held': session.held}
    if output is None:
        return values
    for i, name in enumerate(session.config.contact_names):
        values[name] = 'force' if output.active[i] else 'motion'
        values[f'{name} measured_n'] = float(output.alpha_meas[i])
        values[f'{name} estimated_n'] = float(output.alpha_est[i])
        values[f'{name} desired_n'] = float(output.alpha_des[i])
        values[f'{name} noise_variance_n2'] = float(session.variance[i])
    return values


def warm_up(session: ControlSession) -> None:
    """Take a step that nobody sees: the first one takes a hundred times as long."""
    joints = np.linspace(0.4, 1.0, len(session.config.robot.joint_names))
    with contextlib.suppress(MulticontactError):
        output = session.step(PairedSample(0, joints, 0.0 * joints, np.zeros(6)))
        pose = output.pose
        messages.pose_message(0, pose.position_world, pose.quaternion_xyzw, WORLD_FRAME)
    session.restart()


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
