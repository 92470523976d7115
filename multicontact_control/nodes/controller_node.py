"""The controller as a ROS 2 node: samples in, joint torques out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
import sys
import time
from typing import Any

from multicontact_control.config import ControllerConfig
from multicontact_control.control_loop import ControlLoop
from multicontact_control.errors import (
    ContactGeometryError,
    MessageError,
    MulticontactError,
    SingularTaskError,
)
from multicontact_control.nodes import qos, topics
from multicontact_control.nodes.command_interface import CommandInterface
from multicontact_control.nodes.controller_config import ControllerNodeConfig, SAFE_TIME
from multicontact_control.nodes.controller_events import ControllerEvents
from multicontact_control.nodes.controller_outputs import Command, ControllerOutputs
from multicontact_control.nodes.controller_status import (
    contact_status,
    sensor_status,
    SupervisorReport,
)
from multicontact_control.nodes.diagnostics import (
    input_status,
    message_status,
    MissingInputs,
    STALE_PERIODS,
    Status,
)
from multicontact_control.nodes.graph_node import StartupGate
from multicontact_control.nodes.loop_statistics import (
    DurationLog,
    Freshness,
    LoopStatistics,
    NANOSECONDS,
)
from multicontact_control.nodes.managed_node import ACTIVE, ManagedNode
from multicontact_control.nodes.runtime import run_node, Spinner
from multicontact_control.nodes.streams import (
    effort_reader,
    joint_state_reader,
    MessageReader,
    wrench_reader,
)
from multicontact_control.sampling import Action, SampleTiming
from multicontact_control.supervision.inputs import JointInput, TickInputs, WrenchInput
import numpy as np

# Samples from which on a rate is known, and the factor from which on it is a wrong one.
FEWEST, WRONG_RATE = 10, 1.3


class ControllerNode(ManagedNode):
    """
    Reads messages, does what `SampleTiming` says, steps the control loop, publishes its answer.

    After a deactivation samples are answered by the declared safe behaviour.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(
            topics.CONTROLLER, ControllerConfig, ControllerNodeConfig, **options)
        self._loop: ControlLoop | None = None
        self._commands: CommandInterface | None = None
        self._outputs: ControllerOutputs | None = None
        self._events: ControllerEvents | None = None
        self._report: SupervisorReport | None = None
        self._missing: MissingInputs | None = None
        self._node_config = ControllerNodeConfig()
        self._readers: dict[topics.Topic, MessageReader[Any]] = {}
        self._watch, self._fresh = LoopStatistics(), Freshness()
        self._timing = SampleTiming(1.0)
        # From the last message of a sample to its command sent; the loop's step and what is
        # published of the tick by themselves.
        self._ticks, self._steps, self._shows = DurationLog(), DurationLog(), DurationLog()
        self._heard = self._received = 0  # messages of whatever use, and when the last came
        self._taken = self._last_taken = 0  # samples, and when the last was complete
        self._reported_at, self._restarts = (0, -1), 0
        self._warned: set[str] = set()
        self._last_command: Command | None = None
        self._instruction, self._collisions = '', 0

    def configure(self, configurations: Sequence[Any]) -> None:
        """Build the controller and its ends of the topics."""
        config: ControllerConfig
        config, self._node_config = configurations
        node_config, lockstep = self._node_config, self._node_config.lockstep
        loop = ControlLoop(
            config, node_config.scenario(config), node_config.command, node_config.folder,
            supervised=node_config.supervised)
        warm_up(loop)
        self._loop, self._watch = loop, LoopStatistics(config.rate)
        self._report = SupervisorReport(loop)
        self._timing = SampleTiming(
            config.rate, supervised=node_config.supervised, lockstep=lockstep,
            feels=config.wrench_input != 'momentum', patience=node_config.patience,
            pair_tolerance=node_config.pair_tolerance)
        self._outputs = ControllerOutputs(self, self.streams, config, node_config)
        self._wrench = topics.WRENCHES.get(config.wrench_input, topics.WRENCH)
        joints, columns = config.robot.joint_names, config.column_names
        frame = config.robot.sensor_frame
        nameless = (f'{self._wrench.name}: header.frame_id is empty: it is taken for {frame} '
                    '(robot.sensor_frame)')
        inputs: dict[topics.Topic, tuple[MessageReader[Any], Callable[[bytes], None], str]] = {
            topics.NOISE_VARIANCE: (
                effort_reader(columns), self._on_noise_variance,
                f'an effort [N^2] for each of {", ".join(columns)}; the last R is held'),
            self._wrench: (
                wrench_reader(frame, lambda: self._warn_once(nameless, 'frame')), self._on_wrench,
                f'force [N] and torque [N m] in the axes of {frame}, stamped'),
            topics.JOINT_STATES: (
                joint_state_reader(joints), self._on_joint_states,
                f'position and velocity [rad, rad/s] of {", ".join(joints)}, stamped')}
        if config.wrench_input == 'momentum':
            del inputs[self._wrench]
        self._readers = {topic: reader for topic, (reader, _, _) in inputs.items()}
        profile = qos.INPUT if lockstep else qos.SENSOR
        for topic, (_, callback, _) in inputs.items():
            self.streams.subscribe(topic, callback, profile)
        self._missing = MissingInputs(
            self, self._fresh, {topic: (profile, text) for topic, (_, _, text) in inputs.items()})
        self._events = ControllerEvents(self, loop, lambda: self.state)
        self._commands = CommandInterface(
            self, loop, self.refusals, self._events,
            lambda bias: self.parameter_set.assign('tool.bias_sensor', bias))
        self._commands.adopt(node_config)
        self._forget()

    def _warn_once(self, text: str, cause: str) -> str:
        """Log a warning, unless one of that cause has been; return it."""
        if cause not in self._warned:
            self._warned.add(cause)
            self.get_logger().warning(text)
        return text

    def activate(self) -> StartupGate:
        """Start with the next sample, as if there had been none."""
        self._configured.restart()
        self._forget()
        subscriptions, outputs = dict(self.streams.subscriptions), dict(self.streams.publishers)
        if self._commands and self._outputs and self._events:
            subscriptions |= self._commands.subscriptions
            outputs = {**self._outputs.publishers, topics.STATUS: self._events.publisher}
        return StartupGate(self, outputs, subscriptions, self._node_config)

    def deactivate(self) -> None:
        """Go over to the safe behaviour."""
        self._last_command = None
        self._configured.supervisor.stop()
        kind = self._configured.config.safe_behaviour.replace('_', ' ')
        self.get_logger().info(f'deactivated: commanding {kind} from the next sample on')

    def take_leave(self, spinner: Spinner) -> None:
        """Go over to the safe behaviour, for as long as a robot has to be left with some."""
        if not self.working:
            return
        self.trigger_deactivate()
        end = time.monotonic_ns() + SAFE_TIME * NANOSECONDS
        # A robot that has been silent for as long is gone already.
        while time.monotonic_ns() < min(end, self._last_taken + SAFE_TIME * NANOSECONDS):
            self.spin_once(spinner)

    def clean_up(self) -> None:
        """Free the controller, and the topics that are no streams."""
        for ends in (self._commands, self._outputs, self._events):
            if ends is not None:
                ends.close()
        self._loop = self._commands = self._outputs = self._report = self._events = None
        self._missing = None
        self._timing.restart()

    def check(self, configurations: Sequence[Any]) -> None:
        """Raise if the controller cannot go on with new configurations."""
        self._configured.supervisor.check(configurations[0])

    def reconfigure(self, configurations: Sequence[Any]) -> None:
        """Go on with new configurations from the next sample on."""
        loop = self._configured
        config, self._node_config = configurations
        loop.limits = self._node_config.command
        if self._commands is not None:
            self._commands.adopt(self._node_config)
        if config != loop.config:
            loop.supervisor.reconfigure(config)

    @property
    def _configured(self) -> ControlLoop:
        if self._loop is None:
            raise MulticontactError('the controller is not configured')
        return self._loop

    def close(self) -> None:
        """Write the counts of this run, if asked to."""
        events = self._loop.events.events if self._loop is not None else []
        self._node_config.write_counts({
            'steps': self._ticks.count, 'tick_us': self._ticks.percentiles(),
            'step_us': self._steps.percentiles(), 'show_us': self._shows.percentiles(),
            'refused': dict(self.refusals.counts), 'unpaired': self._timing.unpaired,
            'restarts': self._restarts, 'events': events})

    def _forget(self) -> None:
        self._last_command = None
        self._timing.restart()
        self._fresh.expect(*(topic.name for topic in self._readers))
        if self._missing is not None:
            self._missing.restart()

    def _on_joint_states(self, data: bytes) -> None:
        with self.refusals.guard(topics.JOINT_STATES):
            self._timing.add_joints(self._read(topics.JOINT_STATES, data))
            self._answer(self._received)

    def _on_wrench(self, data: bytes) -> None:
        with self.refusals.guard(self._wrench):
            self._timing.add_wrench(self._read(self._wrench, data))
            self._answer(self._received)

    def _on_noise_variance(self, data: bytes) -> None:
        with self.refusals.guard(topics.NOISE_VARIANCE):
            start = time.monotonic_ns()
            reading = self._readers[topics.NOISE_VARIANCE].read(data)
            if min(reading.values.tolist()) <= 0.0:
                raise MessageError('effort', 'variances above 0', reading.values.tolist())
            self._fresh.note(topics.NOISE_VARIANCE.name)
            self._timing.add_variance(reading.stamp, reading.values)
            self._answer(start)

    def _read(self, topic: topics.Topic, data: bytes) -> Any:
        """Return the reading in a message; one that is refused does not count as come."""
        self._heard += 1
        self._received = time.monotonic_ns()
        reading = self._readers[topic].read(data)
        self._fresh.note(topic.name)
        return reading

    def gate_opened(self) -> None:
        """Answer the sample that waits."""
        self._answer(time.monotonic_ns())

    def _answer(self, start: int) -> None:
        """Do what is to be done now, after a message that came at a monotonic time [ns]."""
        loop = self._configured
        if not (self.working or loop.safe):
            return
        action, inputs = self._timing.what_now(start, safe=loop.safe)
        if action in (Action.STEP, Action.ANEW, Action.REPEAT):
            self._watch.add_period(self._received)
            self._last_taken = self._received
            self._taken += 1
        if action is Action.ANEW:
            self.get_logger().warning('samples start anew: the controller starts anew')
            loop.restart()
            self._restarts += 1
        if action in (Action.STEP, Action.ANEW):
            self._command(loop, inputs, start)
            self._watch.add_latency(time.monotonic_ns() - self._received)
            begin = time.monotonic_ns()
            self._show(loop)
            self._shows.add(time.monotonic_ns() - begin)
            self._guide(loop)
        elif action is Action.REPEAT and self._last_command and self._outputs:
            self._outputs.send(self._last_command)
        elif action is Action.SHOW:
            self._show(loop)
        elif action is Action.REFUSE:
            raise MessageError(
                'stamp', 'one after that of the last sample', 'an older one')

    def patience(self) -> float:
        """Return how long to wait for the next callback at most [s]."""
        longest, due = super().patience(), self._timing.due
        return min(longest, max(0.0, (due - time.monotonic_ns()) * 1e-9)) if due else longest

    def look(self, spinner: Spinner) -> None:
        """Go on with half a sample, or without any, if it is time."""
        loop, due, heard = self._loop, self._timing.due, -1
        if self._missing is not None and self.state == ACTIVE:
            self._missing.poll()
        if loop is None or not due or time.monotonic_ns() < due:
            return
        while heard != self._heard and not spinner.stop:
            heard = self._heard  # what waits in a queue has come: it goes first
            spinner.spin_once(0.0)
        if not (self.working or loop.safe):
            return
        with self.refusals.guard(topics.JOINT_STATES):
            now = time.monotonic_ns()
            action, inputs = self._timing.late(now)
            if action is not Action.WAIT:
                self._command(loop, inputs, now)
            if action is Action.HALF:
                self._show(loop)

    def _command(self, loop: ControlLoop, inputs: TickInputs, start: int) -> None:
        """Step and send the command: everything else can wait, the robot cannot."""
        self._last_command = None
        begin = time.monotonic_ns()
        try:
            torque = loop.step(inputs)
        except (SingularTaskError, ContactGeometryError) as error:
            self.get_logger().error(  # only bare: a supervisor would have answered
                f'{error}; going over to the safe behaviour, until activated anew')
            torque = loop.stop()
        self._steps.add(time.monotonic_ns() - begin)
        if self._outputs is not None:
            self._last_command = self._outputs.command(self._timing.expected_stamp, torque)
            self._outputs.send(self._last_command)
        self._ticks.add(time.monotonic_ns() - start)
        if self._events is not None:
            self._events.look()

    def _show(self, loop: ControlLoop) -> None:
        if self._outputs is not None and loop.output is not None:
            self._outputs.show(self._timing.expected_stamp, self._timing.tick, loop.output)

    def _guide(self, loop: ControlLoop) -> None:
        """Log what a push test waits for, whenever that changes, and what the arm meets."""
        before, self._instruction = self._instruction, loop.push_gate.instruction
        if self._instruction not in ('', before):
            self.get_logger().info(f'push test: {self._instruction}')
        collisions = loop.collisions.total()
        if collisions > self._collisions and loop.status is not None:
            self.get_logger().warning(
                f'{" ".join(loop.status.causes)}: something touches the arm before its wrist '
                f'sensor; reaction: {loop.status.reaction}')
        self._collisions = collisions

    def statuses(self) -> list[Status]:
        """Return what diagnostics report."""
        loop = self._configured
        if self._events is not None:
            self._events.repeat()
        self._watch.missed, self._timing.skipped = self._timing.skipped, 0
        timing = {**self._watch.report(), 'steps': self._ticks.count,
                  'restarts': self._restarts, 'safe_behaviour': loop.safe,
                  'supervised': loop.supervised}
        missed = timing['deadline_misses']
        return [
            Status('loop', timing, warning='; '.join(filter(None, (
                f'{missed} samples without a command' if missed else '',
                self._without_pairs(loop), self._at_another_rate(loop))))),
            input_status(self._fresh, STALE_PERIODS * loop.config.period, needed=(
                self.state == ACTIVE), consequence=self._without_variance(loop)),
            contact_status(loop, self._timing.variance), sensor_status(loop),
            message_status(self.refusals, unpaired=self._timing.unpaired, slow=sum(
                reader.slow for reader in self._readers.values())),
            *([self._report.status()] if loop.supervised and self._report else [])]

    def _at_another_rate(self, loop: ControlLoop) -> str:
        """Say at what rate samples have come since this was asked last, if it is a wrong one."""
        newest = self._timing.last_stamp
        (taken, stamp), self._reported_at = self._reported_at, (self._taken, newest)
        count, elapsed = self._taken - taken, (newest - stamp) / NANOSECONDS
        if self.state != ACTIVE or stamp < 0 or count < FEWEST or elapsed < 0.0:
            return ''
        if not elapsed:
            return self._warn_once(
                f'samples come, but their stamps stand still at {newest * 1e-9:.9g} s: '
                'expected a stamp of its own for each', 'still')
        rate, expected = count / elapsed, loop.config.rate
        return '' if expected / WRONG_RATE < rate < expected * WRONG_RATE else self._warn_once(
            f'samples come at {rate:.4g} Hz: expected {expected:g} Hz (rate)', 'rate')

    def _without_pairs(self, loop: ControlLoop) -> str:
        """Return how far joint states and wrenches are apart if none of them is a pair."""
        ages = self._fresh.ages()
        both = [ages.get(topic.name) for topic in (topics.JOINT_STATES, self._wrench)]
        since = (time.monotonic_ns() - self._last_taken) / NANOSECONDS
        if self.state != ACTIVE or since < 1.0 or not self._timing.apart or any(
                age is None or age > 1.0 for age in both):
            return ''
        return self._warn_once(
            f'{topics.JOINT_STATES.name} and {self._wrench.name} come, but their stamps '
            f'are {abs(self._timing.apart) * 1e-6:.6g} ms apart: expected at most '
            f'{self._node_config.pair_tolerance:g} periods of {1e3 * loop.config.period:g} ms '
            '(pair_tolerance), of one clock', 'apart')

    def _without_variance(self, loop: ControlLoop) -> str:
        """Return what is done about an R that is not renewed, nothing if it is."""
        age = self._fresh.ages().get(topics.NOISE_VARIANCE.name)
        if age is not None and age <= STALE_PERIODS * loop.config.period:
            return ''
        inflated = loop.supervised and self._timing.variance is not None
        return ': the last R is held' + (' and inflated' if inflated else '')


def warm_up(loop: ControlLoop) -> None:
    """Take a step that is not sent: the first one takes a hundred times as long."""
    joints = np.linspace(0.4, 1.0, len(loop.config.robot.joint_names))
    with contextlib.suppress(MulticontactError):
        loop.step(TickInputs(0.0, JointInput(0.0, joints, 0.0 * joints),
                             WrenchInput(0.0, np.zeros(6))))
        if loop.output is not None:
            loop.output.pose.quaternion_xyzw  # noqa: B018 - compiled too
    loop.restart()


def main() -> int:
    """Run the controller node."""
    return run_node(ControllerNode)


if __name__ == '__main__':
    sys.exit(main())
