"""The controller as a ROS 2 node: samples in, joint torques out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
from functools import partial
from pathlib import Path
import sys
import time
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig, parameter, read_yaml, validate
from multicontact_control.control.controller import ControllerDesign
from multicontact_control.control.motions import with_waypoints_of_file
from multicontact_control.control.tasks import ReferenceConfig, ScenarioTask
from multicontact_control.errors import ConfigError, MessageError, MulticontactError
from multicontact_control.loop import ControlLoop
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.controller_report import ControllerReport
from multicontact_control.nodes.controller_topics import (
    CommandServers,
    ControllerOutputs,
)
from multicontact_control.nodes.diagnostics import ComponentStatus
from multicontact_control.nodes.graph import SAFE_TIME, StartupConfig
from multicontact_control.nodes.lifecycle import CONFIGURED, ManagedNode
from multicontact_control.nodes.parameters import find_parameter_folder
from multicontact_control.nodes.runtime import run_node, Spinner
from multicontact_control.nodes.streams import MessageReader
from multicontact_control.sampling import (
    Action,
    Decision,
    NANOSECONDS,
    SampleTiming,
)
from multicontact_control.sensor.push_test import PushTestConfig
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.inputs import JointInput, TickInputs, WrenchInput
import numpy as np

# Actions on a sample with a new stamp, on one with both halves, and on one of which forces and
# poses are published.
NEW_SAMPLE = (Action.STEP, Action.STEP_ANEW, Action.STEP_BY_HALF)
WHOLE_SAMPLE = (Action.STEP, Action.STEP_ANEW, Action.REPEAT_TORQUE)
PUBLISHED = (*NEW_SAMPLE, Action.PUBLISH_AGAIN)


class ControllerNodeConfig(StartupConfig):
    """
    Parameters of the node around the controller: timing of samples, source of the task, commands.

    The controller's own are in `ControllerConfig`; a file has both side by side.
    """

    supervised: bool = parameter(
        True,
        'Whether contact states, watchdogs, limits and the last gate are around the control '
        'law; without them it is the law alone, as its claims are measured.',
    )
    lockstep: bool = parameter(
        False,
        'Whether to wait for the noise variance of one sample before answering the next.',
    )
    patience: float = parameter(
        1.5,
        'Periods after a sample from which the next is waited for no longer: what has come '
        'of it is used, and one period later the tick is taken without it. 0 to wait for ever; '
        'only with supervision, and not in lockstep.',
        ge=0.0,
        le=100.0,
    )
    pair_tolerance: float = parameter(
        0.5,
        'Largest difference between the stamps of a joint state and a wrench that are taken '
        'for one sample.',
        unit='periods',
        ge=0.0,
        le=0.5,
    )
    reference_file: str = parameter(
        '',
        'YAML file of a scenario or its reference, with a path like that of robot.urdf; empty '
        'to obey the command topics.',
    )
    effort_output_topic: str = parameter(
        '',
        'Topic for the bare efforts (std_msgs/Float64MultiArray) that the forward '
        'controllers of ros2_control take; empty for none.',
    )
    command: CommandLimits = CommandLimits()
    push_test: PushTestConfig = PushTestConfig()

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        if self.patience and self.patience < 1.0:
            yield ConfigError('patience', '0, or at least 1 period', self.patience)

    def scenario(self, config: ControllerConfig, folder: Path) -> ScenarioTask | None:
        """
        Return the scenario to follow, None to obey commands.

        The file may be a whole scenario, of which the reference alone counts here. A relative path
        starts at `folder`. ConfigError if the file is unreadable or does not fit the controller.
        """
        if not self.reference_file:
            return None
        path = folder / self.reference_file
        values = read_yaml(path)
        reference = validate(
            ReferenceConfig,
            with_waypoints_of_file(values.get('reference', values), path.parent),
            str(path),
        )
        return ScenarioTask.for_controller(reference, config)


class ControllerNode(ManagedNode):
    """
    Answers each pair of joint state and wrench with joint torques.

    Once it has been active, a deactivated controller answers samples by the safe behaviour, until
    it is cleaned up: a robot that is left without commands may fall.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(
            topics.CONTROLLER, ControllerConfig, ControllerNodeConfig, **options
        )
        self._message_count = 0  # of all inputs, also of messages that are refused
        self._find_folder = partial(
            find_parameter_folder,
            node_name=self.get_name(),
            arguments=options.get('cli_args', sys.argv),
        )

    def configure(self, configurations: Sequence[Any]) -> None:
        """
        Build the controller, its subscriptions, publishers and services.

        Raises
        ------
        MulticontactError
            If a file is unreadable, or the arm, the contacts or the scenario are unusable.

        """
        config, node_config = configurations
        self._node_config = node_config
        self._torque: Vector | None = None  # the newest, shape (n,) [N m]
        self._loop = self._build_loop(config)
        self._timing = SampleTiming(
            config.rate,
            supervised=node_config.supervised,
            lockstep=node_config.lockstep,
            has_wrench=config.wrench_input != 'momentum',
            patience=node_config.patience,
            pair_tolerance=node_config.pair_tolerance,
        )
        self._readers = _build_readers(config)
        self._outputs = ControllerOutputs(self, config, node_config.effort_output_topic)
        self._report = ControllerReport(
            self,
            self._loop,
            self._timing,
            [*self._readers],
            may_pause=node_config.lockstep,
        )
        self._servers = CommandServers(
            self, self._loop, self._report, self._get_push_test
        )
        for topic in self._readers:
            self.create_subscription(
                topic.message,
                topic.name,
                partial(self._on_message, topic),
                qos.INPUT if node_config.lockstep else qos.SENSOR,
                raw=True,
            )

    def _build_loop(self, config: ControllerConfig) -> ControlLoop:
        """Return the control loop, compiled and warmed up; log what is suspicious of the arm."""
        scenario = self._node_config.scenario(
            config, self._find_folder('reference_file')
        )
        loop = ControlLoop(
            config,
            scenario,
            self._node_config.command,
            self._find_folder('robot.urdf'),
            supervised=self._node_config.supervised,
        )
        for text in loop.warnings:
            self.get_logger().warning(text)
        self.get_logger().info(loop.remark)
        _warm_up(loop)
        return loop

    def _get_push_test(self) -> PushTestConfig:
        return self._node_config.push_test

    def activate(self) -> ControllerNodeConfig:
        """Start with the next sample, as if there had been none."""
        self._loop.restart()
        self._timing.restart()
        self._report.inputs.restart()
        self._torque = None
        self.due = 0
        return self._node_config

    def deactivate(self) -> None:
        """Go over to the safe behaviour."""
        self._torque = None
        self._loop.supervisor.stop()
        kind = self._loop.config.safe_behaviour.replace('_', ' ')
        self.get_logger().info(
            f'deactivated: commanding {kind} from the next sample on'
        )

    def shutdown_safely(self, spinner: Spinner) -> None:
        """
        Command the safe behaviour for `SAFE_TIME` before the process ends.

        A robot that has been silent for as long needs none: the time counts from its last sample.
        """
        if not self.working:
            return
        self.trigger_deactivate()
        start = time.monotonic_ns()
        safe_time = int(SAFE_TIME * NANOSECONDS)
        while time.monotonic_ns() < min(start, self._report.watch.last) + safe_time:
            self.spin_once(spinner)

    def write_run_counts(self) -> None:
        """Write ticks, latencies, refusals and events of this run to `timing_file`, if given."""
        latencies = self._report.watch.latencies
        self._node_config.write_counts(
            {
                'steps': latencies.count,
                'tick_us': latencies.percentiles(),
                'refused': dict(self.refusals.counts),
                'unpaired': self._timing.unpaired,
                'restarts': self._report.restarts,
                'events': [*self._loop.events.events],
            }
        )

    def compute_design(
        self, configurations: Sequence[Any]
    ) -> tuple[ControllerDesign | None, Any]:
        """
        Return the design of a changed controller, and the node's configuration.

        The design is None if the controller's configuration is as it was. Takes long: called by
        another thread. MulticontactError if no controller can be made.
        """
        config, node_config = configurations
        design = None
        if config != self._loop.config:
            design = self._loop.design(config)
        return design, node_config

    def apply_design(self, design: tuple[ControllerDesign | None, Any]) -> None:
        """Go on with a design from the next sample on; MulticontactError if that cannot be now."""
        controller_design, node_config = design
        if controller_design is not None:
            self._loop.use(controller_design)
        self._node_config = node_config
        self._loop.limits = node_config.command

    def collect_statuses(self) -> Iterator[ComponentStatus | None]:
        """Yield the statuses of loop, inputs, contacts, sensor, supervisor; None for a pause."""
        return self._report.collect_statuses()

    def _on_message(self, topic: topics.Topic, data: bytes) -> None:
        """Take in a reading or an R, and answer the sample that it completes."""
        if self.state not in CONFIGURED:
            return  # it was on its way when its subscription was destroyed
        start = time.monotonic_ns()
        self._message_count += 1
        try:
            reading = self._readers[topic](data)
            if topic is topics.NOISE_VARIANCE:
                self._timing.add_noise_variance(*reading)
            elif topic is topics.JOINT_STATES:
                self._timing.add_reading(JointInput(*reading))
            else:
                self._timing.add_reading(WrenchInput(*reading))
            safe = self._loop.supervisor.safe
            if self.working or safe:
                self._carry_out(self._timing.decide_on_message(start, safe=safe), start)
            self._report.inputs.last[topic] = start
        except MulticontactError as error:
            self.refusals.log_refusal(topic.name, error)

    def do_due_work(self, spinner: Spinner) -> None:
        """Answer a sample that has waited for the gate; at `due`, half a sample or none."""
        self._servers.poll()
        late = 0 < self.due <= time.monotonic_ns()
        if late:
            self._run_waiting_callbacks(spinner)
        safe = self._loop.supervisor.safe
        if not (self.working or safe):
            return
        now = time.monotonic_ns()
        if late:
            decision = self._timing.decide_on_silence(now)
        else:
            decision = self._timing.decide_on_message(now, safe=safe)
        self._carry_out(decision, now)

    def _run_waiting_callbacks(self, spinner: Spinner) -> None:
        """Take in the messages that wait in queues: what has come is not late."""
        count = -1
        while count != self._message_count and not spinner.stop:
            count = self._message_count
            spinner.spin_once(0.0)

    def _carry_out(self, decision: Decision, start: int) -> None:
        """Answer a message of a monotonic time [ns] as decided: command first, then reports."""
        action, inputs = decision
        loop = self._loop
        self.due = self._timing.silence_deadline
        if action is Action.STEP_ANEW:
            self._start_anew()
        elif action is Action.REFUSE:
            self._refuse_older_sample()
        if inputs is not None:
            self._torque = None  # unless the step returns one
            try:
                self._torque = loop.step(inputs)
            except MulticontactError as error:
                self._torque = self._stop_because_of(error)
        elif (
            action is Action.REPEAT_TORQUE
            and loop.supervisor.safe
            and self._torque is None
        ):
            self._torque = loop.stop()  # the robot waits, and was deactivated meanwhile
        answers = inputs is not None or action is Action.REPEAT_TORQUE
        if answers and self._torque is not None:
            outputs = self._outputs
            stamp = self._timing.answered_stamp
            outputs.publish_command(outputs.encode_command(stamp, self._torque))
            outputs.publish_bare_efforts(self._torque)
        if inputs is not None:
            self._report.watch.latencies.add(time.monotonic_ns() - start)
            self._report.report_changes()
        if action in NEW_SAMPLE:
            self._report.samples += 1
        if action in WHOLE_SAMPLE:
            self._report.watch.add_turn(start)
        if action in PUBLISHED and loop.output is not None:
            self._outputs.publish_tick(
                self._timing.answered_stamp, self._timing.tick, loop.output
            )

    def _start_anew(self) -> None:
        """Forget the past: stamps have been set back, or samples begin again."""
        self.get_logger().warning('samples start anew: the controller starts anew')
        self._loop.restart()
        self._report.restarts += 1

    def _refuse_older_sample(self) -> None:
        error = MessageError(
            'stamp', 'one after that of the last sample', 'an older one'
        )
        self.refusals.log_refusal(topics.JOINT_STATES.name, error)

    def _stop_because_of(self, error: MulticontactError) -> Vector:
        """Return the torque of the safe behaviour; bare only, a supervisor answers itself."""
        self.get_logger().error(
            f'{error}; going over to the safe behaviour, until activated anew'
        )
        return self._loop.stop()


def _build_readers(config: ControllerConfig) -> dict[topics.Topic, MessageReader]:
    """Return the readers of R, joint states and, unless momentum stands in, the wrench."""
    robot = config.robot
    read_joints = partial(
        messages.read_named_vectors,
        names=robot.joint_names,
        fields=('position',),
        optional=('velocity',),
        unchecked=('effort',) if robot.measures_torque else (),
    )
    readers = {
        topics.NOISE_VARIANCE: partial(
            messages.read_variance, names=config.column_names
        ),
        topics.JOINT_STATES: read_joints,
    }
    wrench = topics.WRENCHES.get(config.wrench_input)
    if wrench is not None:
        readers[wrench] = partial(messages.read_wrench, frame=robot.sensor_frame)
    return {
        topic: MessageReader(topic.message, read) for topic, read in readers.items()
    }


def _warm_up(loop: ControlLoop) -> None:
    """Take a step that is not sent: the first one takes a hundred times as long."""
    q = np.linspace(0.4, 1.0, len(loop.config.robot.joint_names))
    at_rest = JointInput(0.0, q, np.zeros_like(q))
    with contextlib.suppress(MulticontactError):
        loop.step(TickInputs(0.0, at_rest, WrenchInput(0.0, np.zeros(6))))
        if loop.output is not None:
            loop.output.pose.quaternion_xyzw  # noqa: B018 - compiled too
    loop.restart()


def main() -> int:
    """Run the controller node in this process; return the exit code, see `run_node`."""
    return run_node(ControllerNode)


if __name__ == '__main__':
    sys.exit(main())
