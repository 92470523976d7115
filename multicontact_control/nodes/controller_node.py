"""The controller as a ROS 2 node: samples in, joint torques out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
from functools import partial
from pathlib import Path
import sys
import time
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig, parameter, read_yaml, validate
from multicontact_control.control.controller import Design
from multicontact_control.control.tasks import ReferenceConfig, ScenarioTask
from multicontact_control.errors import ConfigError, MessageError, MulticontactError
from multicontact_control.loop import ControlLoop
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.controller_report import ControllerReport
from multicontact_control.nodes.controller_topics import (
    ControllerOutputs,
    create_command_servers,
)
from multicontact_control.nodes.diagnostics import ComponentStatus
from multicontact_control.nodes.graph import SAFE_TIME, StartupConfig
from multicontact_control.nodes.lifecycle import ACTIVE, INACTIVE, ManagedNode
from multicontact_control.nodes.parameters import find_parameter_folder
from multicontact_control.nodes.runtime import run_node, Spinner
from multicontact_control.nodes.streams import MessageReader
from multicontact_control.sampling import Action, Decision, SampleTiming
from multicontact_control.sensor.push_test import PushTestConfig
from multicontact_control.supervision.command_limits import CommandLimits
from multicontact_control.supervision.inputs import JointInput, TickInputs, WrenchInput
import numpy as np
from std_msgs.msg import Float64MultiArray

NEW = (Action.STEP, Action.ANEW, Action.HALF)
WHOLE = (Action.STEP, Action.ANEW, Action.REPEAT)
SHOWN = (Action.STEP, Action.ANEW, Action.HALF, Action.SHOW)


class ControllerNodeConfig(StartupConfig):
    """Parameters of the node."""

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
        Return the scenario to follow, None to obey commands; ConfigError if it is a bad one.

        A relative path starts at `folder`.
        """
        if not self.reference_file:
            return None
        path = folder / self.reference_file
        values = read_yaml(path)  # of a scenario file more than its reference
        reference = validate(
            ReferenceConfig, values.get('reference', values), str(path)
        )
        return ScenarioTask.of(reference, config)


class ControllerNode(ManagedNode):
    """
    Answers each pair of joint state and wrench with joint torques.

    After a deactivation samples are answered by the declared safe behaviour.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(
            topics.CONTROLLER, ControllerConfig, ControllerNodeConfig, **options
        )
        self._heard = 0  # messages of whatever use
        self._folder_of = partial(
            find_parameter_folder,
            node_name=self.get_name(),
            arguments=options.get('cli_args', sys.argv),
        )

    def configure(self, configurations: Sequence[Any]) -> None:
        """Build the controller and its ends of the topics."""
        config, node_config = configurations
        scenario = node_config.scenario(config, self._folder_of('reference_file'))
        self._loop = loop = ControlLoop(
            config,
            scenario,
            node_config.command,
            self._folder_of('robot.urdf'),
            supervised=node_config.supervised,
        )
        for text in loop.warnings:
            self.get_logger().warning(text)
        self.get_logger().info(loop.remark)
        _warm_up(loop)
        self._timing = timing = SampleTiming(
            config.rate,
            supervised=node_config.supervised,
            lockstep=node_config.lockstep,
            feels=config.wrench_input != 'momentum',
            patience=node_config.patience,
            pair_tolerance=node_config.pair_tolerance,
        )
        robot, wrench = config.robot, topics.WRENCHES.get(config.wrench_input)
        efforts = ('effort',) * robot.measures_torque
        self._inputs: dict[
            topics.Topic, tuple[Callable[..., Any], Callable[..., None]]
        ] = {
            topics.NOISE_VARIANCE: (
                partial(messages.read_variance, names=config.column_names),
                timing.add_variance,
            ),
            topics.JOINT_STATES: (
                partial(
                    messages.read_named_vectors,
                    names=robot.joint_names,
                    fields=('position',),
                    optional=('velocity',),
                    partial=efforts,
                ),
                lambda *reading: timing.add(JointInput(*reading)),
            ),
        }
        if wrench is not None:
            self._inputs[wrench] = (
                partial(messages.read_wrench, frame=robot.sensor_frame),
                lambda *reading: timing.add(WrenchInput(*reading)),
            )
        self._outputs = ControllerOutputs(self, config, node_config.effort_output_topic)
        self._report = ControllerReport(
            self, loop, timing, [*self._inputs], may_pause=node_config.lockstep
        )
        create_command_servers(
            self, loop, self._report.report_answer, lambda: self._node_config.push_test
        )
        for topic, (read, take_in) in self._inputs.items():
            self._inputs[topic] = MessageReader(topic.message, read), take_in
            self.create_subscription(
                topic.message,
                topic.name,
                partial(self._on_message, topic),
                qos.INPUT if node_config.lockstep else qos.SENSOR,
                raw=True,
            )
        self._node_config = node_config
        self._torque: Vector | None = None  # the newest

    def activate(self) -> ControllerNodeConfig:
        """Start with the next sample, as if there had been none."""
        self._loop.restart()
        self._timing.restart()
        self._report.inputs.restart()
        self._torque, self.due = None, 0
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
        """Go over to the safe behaviour for a while, unless the robot has been silent as long."""
        if not self.working:
            return
        self.trigger_deactivate()
        start = time.monotonic_ns()
        while (
            time.monotonic_ns() < min(start, self._report.watch.last) + SAFE_TIME * 1e9
        ):
            self.spin_once(spinner)

    def write_run_counts(self) -> None:
        """Write the counts of this run, if asked to."""
        report = self._report
        self._node_config.write_counts(
            {
                'steps': report.watch.latencies.count,
                'tick_us': report.watch.latencies.percentiles(),
                'refused': dict(self.refusals.counts),
                'unpaired': self._timing.unpaired,
                'restarts': report.restarts,
                'events': [*self._loop.events.events],
            }
        )

    def compute_design(
        self, configurations: Sequence[Any]
    ) -> tuple[Design | None, Any]:
        """Compute what a new configuration of the controller leads to; None if it is as it was."""
        config, node_config = configurations
        if config == self._loop.config:
            return None, node_config
        return self._loop.design(config), node_config

    def apply_design(self, design: tuple[Design | None, Any]) -> None:
        """Go on with new configurations from the next sample on; raise if that cannot be."""
        new, node_config = design
        if new is not None:
            self._loop.use(new)
        self._node_config, self._loop.limits = node_config, node_config.command

    def collect_statuses(self) -> Iterator[ComponentStatus | None]:
        """Yield what diagnostics report, and None for a pause."""
        return self._report.collect_statuses()

    def _on_message(self, topic: topics.Topic, data: bytes) -> None:
        """Take in a message, and do what it leads to."""
        if self.state not in (ACTIVE, INACTIVE):
            return  # it was on its way when the end of its topic was destroyed
        start = time.monotonic_ns()
        self._heard += 1
        read, take_in = self._inputs[topic]
        try:
            take_in(*read(data))
            safe = self._loop.supervisor.safe
            if self.working or safe:
                self._carry_out(self._timing.what_now(start, safe=safe), start)
            self._report.inputs.last[topic] = start
        except MulticontactError as error:
            self.refusals.log_refusal(topic.name, error)

    def do_due_work(self, spinner: Spinner) -> None:
        """Answer what has waited for the gate; go on with half a sample or none if it is time."""
        now, heard = time.monotonic_ns(), -1
        late = 0 < self.due <= now
        while late and heard != self._heard and not spinner.stop:
            heard = self._heard  # what waits in a queue has come: it goes first
            spinner.spin_once(0.0)
        safe = self._loop.supervisor.safe
        if self.working or safe:
            now = time.monotonic_ns()
            self._carry_out(
                self._timing.late(now)
                if late
                else self._timing.what_now(now, safe=safe),
                now,
            )

    def _carry_out(self, decision: Decision, start: int) -> None:
        """Do what is due after a message that came at a monotonic time [ns], command first."""
        action, inputs = decision
        loop, timing, outputs = self._loop, self._timing, self._outputs
        self.due = timing.due
        if action is Action.ANEW:
            self.get_logger().warning('samples start anew: the controller starts anew')
            loop.restart()
            self._report.restarts += 1
        elif action is Action.REFUSE:
            self.refusals.log_refusal(
                topics.JOINT_STATES.name,
                MessageError(
                    'stamp', 'one after that of the last sample', 'an older one'
                ),
            )
        if inputs is not None:
            self._torque = None
            try:
                self._torque = loop.step(inputs)
            except MulticontactError as error:
                self.get_logger().error(  # only bare: a supervisor would have answered
                    f'{error}; going over to the safe behaviour, until activated anew'
                )
                self._torque = loop.stop()
        elif action is Action.REPEAT and loop.supervisor.safe and self._torque is None:
            self._torque = loop.stop()  # the robot waits, and was deactivated meanwhile
        if self._torque is not None and (inputs is not None or action is Action.REPEAT):
            outputs.publish(outputs.command(timing.answered_stamp, self._torque))
            if outputs.publish_bare is not None:
                outputs.publish_bare(Float64MultiArray(data=self._torque))
        if inputs is not None:
            self._report.watch.latencies.add(time.monotonic_ns() - start)
            self._report.report_changes()
        self._report.samples += action in NEW
        if action in WHOLE:
            self._report.watch.add_period(start)
        if action in SHOWN and loop.output is not None:
            outputs.publish_tick(timing.answered_stamp, timing.tick, loop.output)


def _warm_up(loop: ControlLoop) -> None:
    """Take a step that is not sent: the first one takes a hundred times as long."""
    joints = np.linspace(0.4, 1.0, len(loop.config.robot.joint_names))
    with contextlib.suppress(MulticontactError):
        loop.step(
            TickInputs(
                0.0,
                JointInput(0.0, joints, 0.0 * joints),
                WrenchInput(0.0, np.zeros(6)),
            )
        )
        if loop.output is not None:
            loop.output.pose.quaternion_xyzw  # noqa: B018 - compiled too
    loop.restart()


def main() -> int:
    """Run the controller node."""
    return run_node(ControllerNode)


if __name__ == '__main__':
    sys.exit(main())
