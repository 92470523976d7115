"""The controller as a ROS 2 node: samples in, joint torques out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
import sys
import time
from typing import Any

from multicontact_control.arrays import Vector
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
from multicontact_control.sampling import PairedSample, SamplePairing, SampleTimeout
import numpy as np

# Samples from which on a rate is known, and the factor from which on it is a wrong one.
FEWEST, WRONG_RATE = 10, 1.3
NO_WRENCH = np.zeros(6)


class ControllerNode(ManagedNode):
    """
    Pairs samples, steps the controller, publishes what it answers.

    Without lockstep the newest noise variance is used, however old. A sample that comes again
    gets the same command again; bare, 25 times at most. With a supervisor, commands go on when
    samples do not come (`SampleTimeout`); one sample that is older than the last is refused then,
    two in a row are a clock that was set back. Bare, and in lockstep, an older sample starts
    everything anew. After a deactivation samples are answered by the declared safe behaviour.
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
        self._pairing = SamplePairing()
        self._patience = SampleTimeout(0.0, 1.0)
        # From the last message of a sample to its command sent; the loop's step and what is
        # published of the tick by themselves.
        self._ticks, self._steps, self._shows = DurationLog(), DurationLog(), DurationLog()
        self._heard = self._received = 0  # messages of whatever use, and when the last came
        self._taken = self._last_taken = 0  # samples, and when the last was complete
        self._reported_at, self._again, self._restarts = (0, -1), 0, 0
        self._warned: set[str] = set()
        self._waiting: PairedSample | None = None
        self._older_stamp: int | None = None
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
        waits = node_config.supervised and not lockstep
        self._patience = SampleTimeout(
            node_config.patience if waits else 0.0, config.period * NANOSECONDS)
        self._outputs = ControllerOutputs(self, self.streams, config, node_config)
        self._wrench = topics.WRENCHES.get(config.wrench_input, topics.WRENCH)
        self._feels = config.wrench_input != 'momentum'
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
        if not self._feels:
            del inputs[self._wrench]
        self._readers = {topic: reader for topic, (reader, _, _) in inputs.items()}
        profile = qos.INPUT if lockstep else qos.SENSOR
        for topic, (_, callback, _) in inputs.items():
            self.streams.subscribe(topic, callback, profile)
        self._missing = MissingInputs(
            self, self._fresh, {topic: (profile, text) for topic, (_, _, text) in inputs.items()})
        self._pairing = SamplePairing(
            round(node_config.pair_tolerance * config.period * NANOSECONDS))
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
        self._configured.safe, self._last_command = True, None
        kind = self._configured.config.safe_behaviour.kind.replace('_', ' ')
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
        self._patience.stop()

    def check(self, configurations: Sequence[Any]) -> None:
        """Raise if the controller cannot go on with new configurations."""
        self._configured.controller.check(configurations[0])

    def reconfigure(self, configurations: Sequence[Any]) -> None:
        """Go on with new configurations from the next sample on."""
        loop = self._configured
        config, self._node_config = configurations
        loop.limits = self._node_config.command
        if self._commands is not None:
            self._commands.adopt(self._node_config)
        if config != loop.config:
            loop.controller.reconfigure(config)

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
            'refused': dict(self.refusals.counts), 'unpaired': self._pairing.unpaired,
            'restarts': self._restarts, 'events': events})

    def _forget(self) -> None:
        self._last_command = self._older_stamp = None
        self._patience.stop()
        if not self._node_config.lockstep:
            self._waiting = None  # it may be old; in lockstep nothing is
        self._fresh.expect(*(topic.name for topic in self._readers))
        if self._missing is not None:
            self._missing.restart()

    def _on_joint_states(self, data: bytes) -> None:
        with self.refusals.guard(topics.JOINT_STATES):
            reading = self._read(topics.JOINT_STATES, data)
            self._take(self._pairing.add_joints(reading) if self._feels else PairedSample(
                reading.stamp, reading.q, reading.qd, NO_WRENCH, reading.effort))

    def _on_wrench(self, data: bytes) -> None:
        with self.refusals.guard(self._wrench):
            self._take(self._pairing.add_wrench(self._read(self._wrench, data)))

    def _read(self, topic: topics.Topic, data: bytes) -> Any:
        """Return the reading in a message; one that is refused does not count as come."""
        self._heard += 1
        self._received = time.monotonic_ns()
        reading = self._readers[topic].read(data)
        self._fresh.note(topic.name)
        return reading

    def _on_noise_variance(self, data: bytes) -> None:
        with self.refusals.guard(topics.NOISE_VARIANCE):
            start = time.monotonic_ns()
            reading = self._readers[topics.NOISE_VARIANCE].read(data)
            if min(reading.values.tolist()) <= 0.0:
                raise MessageError('effort', 'variances above 0', reading.values.tolist())
            self._fresh.note(topics.NOISE_VARIANCE.name)
            loop = self._configured
            if reading.stamp <= loop.last_stamp:  # else left over from before a restart
                loop.take_variance(reading.stamp, reading.values)
                self._answer(start)

    def _take(self, sample: PairedSample | None) -> None:
        if sample is None:
            return
        self._watch.add_period(self._received)
        self._last_taken = self._received
        self._taken += 1
        again = self._waiting is not None and self._waiting.stamp == sample.stamp
        self._waiting = sample
        self._answer(self._received)
        if again and self._waiting is sample:
            # Lockstep stands still: the estimator came after the forces it has to answer.
            self._show(self._configured)

    def gate_opened(self) -> None:
        """Answer the sample that waits."""
        self._answer()

    def _answer(self, start: int = 0) -> None:
        """Answer the sample that waits, unless something it needs is not there yet."""
        sample, loop = self._waiting, self._configured
        if sample is None or not (self.working or loop.safe):
            return
        lockstep = self._node_config.lockstep
        if sample.stamp == loop.last_stamp:
            self._waiting = None
            self._again += 1
            # Bare, nothing else tells that the arm has not been seen for long.
            if self._last_command is not None and self._outputs is not None and (
                    self._again <= STALE_PERIODS or loop.supervisor is not None or lockstep):
                self._outputs.send(self._last_command)
            return
        if sample.stamp < loop.last_stamp and not self._starts_anew(loop, sample.stamp):
            self._waiting = None
            return
        if lockstep and not loop.safe and loop.variance_stamp != loop.last_stamp:
            return
        self._waiting = self._older_stamp = None
        self._again = 0
        self._patience.start(self._received)
        self._command(loop, lambda: loop.step(sample), start)
        self._watch.add_latency(time.monotonic_ns() - self._received)
        begin = time.monotonic_ns()
        self._show(loop)
        self._shows.add(time.monotonic_ns() - begin)
        self._guide(loop)

    def _starts_anew(self, loop: ControlLoop, stamp: int) -> bool:
        """Return whether to go on with a sample that is older than the last."""
        if loop.supervisor is None or self._node_config.lockstep:
            self.get_logger().warning('samples start anew: the controller starts anew')
            loop.restart()
            self._restarts += 1
            return True
        before, self._older_stamp = self._older_stamp, stamp
        if before is not None and stamp >= before:  # the same again waits for an answer
            return True
        self.refusals.refuse(topics.JOINT_STATES.name, MessageError(
            'stamp', 'one after that of the last sample', f'{stamp} ns'))
        return False

    def patience(self) -> float:
        """Return how long to wait for the next callback at most [s]."""
        longest, due = super().patience(), self._patience.due
        return min(longest, max(0.0, (due - time.monotonic_ns()) * 1e-9)) if due else longest

    def look(self, spinner: Spinner) -> None:
        """Go on with half a sample, or without any, if it is time."""
        loop, due, heard = self._loop, self._patience.due, -1
        if self._missing is not None and self.state == ACTIVE:
            self._missing.poll()
        if loop is None or not due or time.monotonic_ns() < due:
            return
        while heard != self._heard and not spinner.stop:
            heard = self._heard  # what waits in a queue has come: it goes first
            spinner.spin_once(0.0)
        now = time.monotonic_ns()
        if not 0 < self._patience.due <= now or not (self.working or loop.safe):
            return
        with self.refusals.guard(topics.JOINT_STATES):
            half = self._pairing.take_half(loop.last_stamp)
            if half is not None:
                self._patience.half_used(now)
                self._command(loop, lambda: loop.step_half(half), now)
                self._show(loop)
            elif periods := self._patience.missed(now):
                self._command(loop, lambda: loop.step_without(periods), now)

    def _command(self, loop: ControlLoop, step: Callable[[], Vector], start: int) -> None:
        """Step and send the command: everything else can wait, the robot cannot."""
        self._last_command = None
        begin = time.monotonic_ns()
        try:
            torque = step()
        except (SingularTaskError, ContactGeometryError) as error:
            self.get_logger().error(  # only bare: a supervisor would have answered
                f'{error}; going over to the safe behaviour, until activated anew')
            torque = loop.stop()
        self._steps.add(time.monotonic_ns() - begin)
        if self._outputs is not None:
            self._last_command = self._outputs.command(loop.expected_stamp, torque)
            self._outputs.send(self._last_command)
        self._ticks.add(time.monotonic_ns() - (start or begin))
        if self._events is not None:
            self._events.look()

    def _show(self, loop: ControlLoop) -> None:
        if self._outputs is not None and loop.output is not None:
            self._outputs.show(loop.expected_stamp, loop.tick, loop.output)

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
        self._watch.missed, loop.skipped = loop.skipped, 0
        timing = {**self._watch.report(), 'steps': self._ticks.count,
                  'restarts': self._restarts, 'safe_behaviour': loop.safe,
                  'supervised': loop.supervisor is not None}
        missed = timing['deadline_misses']
        return [
            Status('loop', timing, warning='; '.join(filter(None, (
                f'{missed} samples without a command' if missed else '',
                self._without_pairs(loop), self._at_another_rate(loop))))),
            input_status(self._fresh, STALE_PERIODS * loop.config.period, needed=(
                self.state == ACTIVE), consequence=self._without_variance(loop)),
            contact_status(loop), sensor_status(loop),
            message_status(self.refusals, unpaired=self._pairing.unpaired, slow=sum(
                reader.slow for reader in self._readers.values())),
            *([self._report.status()] if loop.supervisor is not None and self._report else [])]

    def _at_another_rate(self, loop: ControlLoop) -> str:
        """Say at what rate samples have come since this was asked last, if it is a wrong one."""
        (taken, stamp), self._reported_at = self._reported_at, (self._taken, loop.last_stamp)
        count, elapsed = self._taken - taken, (loop.last_stamp - stamp) / NANOSECONDS
        if self.state != ACTIVE or stamp < 0 or count < FEWEST or elapsed < 0.0:
            return ''
        if not elapsed:
            return self._warn_once(
                f'samples come, but their stamps stand still at {stamp * 1e-9:.9g} s: '
                'expected a stamp of its own for each', 'still')
        rate, expected = count / elapsed, loop.config.rate
        return '' if expected / WRONG_RATE < rate < expected * WRONG_RATE else self._warn_once(
            f'samples come at {rate:.4g} Hz: expected {expected:g} Hz (rate)', 'rate')

    def _without_pairs(self, loop: ControlLoop) -> str:
        """Return how far joint states and wrenches are apart if none of them is a pair."""
        ages = self._fresh.ages()
        both = [ages.get(topic.name) for topic in (topics.JOINT_STATES, self._wrench)]
        since = (time.monotonic_ns() - self._last_taken) / NANOSECONDS
        if self.state != ACTIVE or since < 1.0 or not self._pairing.apart or any(
                age is None or age > 1.0 for age in both):
            return ''
        return self._warn_once(
            f'{topics.JOINT_STATES.name} and {self._wrench.name} come, but their stamps '
            f'are {abs(self._pairing.apart) * 1e-6:.6g} ms apart: expected at most '
            f'{self._node_config.pair_tolerance:g} periods of {1e3 * loop.config.period:g} ms '
            '(pair_tolerance), of one clock', 'apart')

    def _without_variance(self, loop: ControlLoop) -> str:
        """Return what is done about an R that is not renewed, nothing if it is."""
        age = self._fresh.ages().get(topics.NOISE_VARIANCE.name)
        if age is not None and age <= STALE_PERIODS * loop.config.period:
            return ''
        inflated = loop.supervisor is not None and loop.variance_stamp >= 0
        return ': the last R is held' + (' and inflated' if inflated else '')


def warm_up(loop: ControlLoop) -> None:
    """Take a step that is not sent: the first one takes a hundred times as long."""
    joints = np.linspace(0.4, 1.0, len(loop.config.robot.joint_names))
    with contextlib.suppress(MulticontactError):
        loop.step(PairedSample(0, joints, 0.0 * joints, np.zeros(6)))
        if loop.output is not None:
            loop.output.pose.quaternion_xyzw  # noqa: B018 - compiled too
    loop.restart()


def main() -> int:
    """Run the controller node."""
    return run_node(ControllerNode)


if __name__ == '__main__':
    sys.exit(main())
