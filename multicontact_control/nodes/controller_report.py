"""What the controller says of itself: ~/status and its log at once, diagnostics each second."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.geometry import find_misread_friction
from multicontact_control.contact.resolution import resolutions, SPREAD
from multicontact_control.control.controller import ControlOutput
from multicontact_control.loop import ControlLoop
from multicontact_control.nodes import topics
from multicontact_control.nodes.diagnostics import (
    ComponentStatus,
    InputMonitor,
    LoopStatistics,
    refusal_status,
)
from multicontact_control.nodes.graph import create_publisher
from multicontact_control.nodes.lifecycle import ACTIVE, INACTIVE, ManagedNode
from multicontact_control.nodes.messages import (
    ACCEPTED,
    ControllerStatus,
    REFUSED,
    STATE,
)
from multicontact_control.sampling import NANOSECONDS, SampleTiming
from multicontact_control.supervision.contacts import (
    GIVEN_UP,
    LOST,
    RETRACTING,
    STATE_NAMES,
)
from multicontact_control.supervision.reactions import INFLATE, NONE, SEVERITY
from multicontact_control.supervision.report import SupervisorStatus
from rclpy.serialization import serialize_message

REPEAT_TIME = 5 * NANOSECONDS  # in which a line is logged once
STATE_INTERVAL = 20_000_000  # ns, between two messages on a state that changes
ANSWER_INTERVAL = (
    100_000_000  # ns, between two equal answers: motions come at the control rate
)
TROUBLED = tuple(STATE_NAMES[code] for code in (LOST, RETRACTING, GIVEN_UP))
# Samples from which on a rate is known, and the factor from which on it is a wrong one.
FEWEST, WRONG_RATE = 10, 1.3
QUIET = SupervisorStatus(NONE)  # before the first sample, and bare


class ControllerReport:
    """
    Says what becomes of commands, what the controller does, and what is wrong with its inputs.

    `restarts` counts how often samples have begun anew, `samples` those that have another stamp
    than the one before; the turns of `watch` are samples, its latencies last from the newest
    message of a sample to its command. In lockstep the robot `may_pause`.
    """

    def __init__(
        self,
        node: ManagedNode,
        loop: ControlLoop,
        timing: SampleTiming,
        inputs: Sequence[topics.Topic],
        *,
        may_pause: bool,
    ) -> None:
        self._node, self._loop, self._timing = node, loop, timing
        self._status_name = f'{node.get_name()}: status'
        bare = node.parameter_set.present_value('effort_output_topic')
        self._owned = [x.name for x in (*inputs, topics.EFFORT_COMMAND)] + [
            bare
        ] * bool(bare)
        self.inputs = InputMonitor(node, loop.config.rate, *inputs, may_pause=may_pause)
        self.watch = LoopStatistics(loop.config.rate)
        self._publisher = create_publisher(node, topics.STATUS)
        self.samples = self.restarts = self._refused = self._told = 0
        self._next_state = self._next_answer = 0
        self._log_due: dict[str, int] = {}
        self._before: tuple[Any, ...] = (NONE, (), (), '', '')
        self._answered: tuple[Any, ...] = ()
        self._reported_at = (0, 0, -1)  # turns, samples, and the stamp of the newest

    def report_answer(
        self,
        source: str,
        identifier: str,
        error: Exception | None,
        left_out: str = '',
    ) -> None:
        """
        Tell whether a command on a topic or of a service is accepted, or why it is refused.

        `left_out` says what is not obeyed of one that is accepted.
        """
        if self._node.state not in (ACTIVE, INACTIVE):
            return  # the command was on its way when the end of its topic was destroyed
        self._refused += error is not None
        if left_out:
            self._warn(f'left out {source}', f'{source}: {left_out}')
        answer = source, identifier, error is None, bool(left_out)
        now = time.monotonic_ns()
        if (identifier or error is not None) and (
            answer != self._answered or now >= self._next_answer
        ):
            self._answered, self._next_answer = answer, now + ANSWER_INTERVAL
            readers = self._node.count_subscribers(source)
            if error is None:
                self._publish(ACCEPTED, identifier, left_out=left_out, readers=readers)
            else:
                self._publish(
                    REFUSED, identifier, f'{source}: {error}', readers=readers
                )

    def report_changes(self) -> None:
        """Tell what has changed with the newest tick, if anything has."""
        loop, status = self._loop, self._loop.status or QUIET
        instruction = loop.push_gate.instruction
        now = (
            status.reaction,
            status.causes,
            loop.supervisor.findings,
            instruction,
            status.unwatched,
            status.contact_states,
            len(status.read_before),
            loop.supervisor.safe,
            loop.held,
            self._node.state,
            *loop.commanded_forces.values(),
        )
        for name in status.rejected:
            self._warn(name, f'a reading is not used: {name}')
        self._warn('read before', '; '.join(status.read_before))
        if now == self._before or time.monotonic_ns() < self._next_state:
            return
        before, self._before = self._before, now
        # Inactive, no reaction ends in control: the node says what it commands.
        if now[:3] != before[:3] and not loop.supervisor.safe:
            self._warn(
                f'{now[:2]}{bool(now[2])}', self._reaction() or 'control goes on'
            )
        for name, state in zip(loop.config.contact_names, status.contact_states):
            if state == STATE_NAMES[GIVEN_UP] and status.contact_states != before[5]:
                self._warn(
                    f'given up {name}',
                    f'{name}: given up, until it is commanded or '
                    'sought again (contact_state.retry_time, force_ceiling)',
                )
        if status.unwatched != before[4]:
            self._warn(
                f'unwatched {status.unwatched}',
                status.unwatched
                or 'effort in joint_states: of use in all joints again',
            )
        if instruction not in ('', before[3]):
            self._node.get_logger().info(f'push test: {instruction}')
        self._next_state = time.monotonic_ns() + STATE_INTERVAL
        self._publish(STATE)

    def _warn(self, kind: str, text: str) -> str:
        """Log what may happen at every tick, each kind of it once in a while; return it."""
        now = time.monotonic_ns()
        if text and now >= self._log_due.get(kind, 0):
            self._log_due[kind] = now + REPEAT_TIME
            self._node.get_logger().warning(text)
        return text

    def _publish(self, event: str, *answer: str, **details: Any) -> None:
        self._told += 1
        self._publisher.publish(self._state(event, *answer, **details)())

    def _state(
        self,
        event: str,
        identifier: str = '',
        refusal: str = '',
        *,
        left_out: str = '',
        readers: int = 0,
    ) -> Callable[[], DiagnosticStatus]:
        """Return what builds the message of ~/status on an event."""
        loop, status, reaction = (
            self._loop,
            self._loop.status or QUIET,
            self._reaction(),
        )
        trouble = refusal or '; '.join(filter(None, (reaction, left_out)))
        text = (
            trouble
            or loop.push_gate.instruction
            or (
                'safe behaviour'
                if loop.supervisor.safe
                else 'held'
                if loop.held
                else '; '.join(status.read_before) or 'ok'
            )
        )
        state = ControllerStatus(
            event=event,
            command=identifier,
            text=text,
            life_cycle=self._node.state,
            reaction=status.reaction,
            causes=' '.join(status.causes),
            contacts=', '.join(
                f'{name} {state}'
                for name, state in zip(loop.config.contact_names, status.contact_states)
            ),
            held=loop.held,
            refused=self._refused,
            readers=readers,
            push_test=loop.push_gate.instruction,
            unwatched=status.unwatched,
            forces=loop.commanded_forces,
            left_out=left_out,
            placing={
                name: tuple(column.tolist())
                for name, column in loop.supervisor.task.placing_columns().items()
            },
        )
        return partial(
            state.to_message,
            self._status_name,
            DiagnosticStatus.WARN if trouble else DiagnosticStatus.OK,
        )

    def collect_statuses(self) -> Iterator[ComponentStatus | None]:
        """Yield what diagnostics report, and None where a sample may come between."""
        loop, timing, active = self._loop, self._timing, self._node.state == ACTIVE
        told = self._told
        build_message = self._state(STATE)
        yield None
        message = yield from self._node.background.compute(
            lambda: serialize_message(build_message())
        )
        if told == self._told:  # else what is newer has been told meanwhile
            self._publisher.publish(message.result())
        yield None
        self.watch.missed, timing.skipped = timing.skipped, 0
        warnings = (
            [f'{self.watch.missed} samples without a command']
            if self.watch.missed
            else []
        )
        if active:
            warnings += self._odd_samples()
        yield None
        seen = yield from self._node.background.compute(self.watch.report)
        yield ComponentStatus(
            'loop',
            {
                **seen.result(),
                'steps': self.watch.latencies.count,
                'restarts': self.restarts,
                'safe_behaviour': loop.supervisor.safe,
                'supervised': loop.supervisor.guarded,
            },
            '; '.join(warnings),
        )
        held = self.inputs.age(topics.NOISE_VARIANCE) > self.inputs.max_age
        yield self.inputs.status(
            needed=active, consequence=': the last R is held' if held else ''
        )
        yield from self._publishers()
        yield from self._contacts()
        yield from self._sensor()
        yield refusal_status(self._node.refusals, unpaired=timing.unpaired)
        if loop.supervisor.guarded:
            yield from self._supervisor()

    def _odd_samples(self) -> Iterator[str]:
        """Yield what is odd of readings: no pairs, the rate since the last call."""
        timing, config, now = self._timing, self._loop.config, time.monotonic_ns()
        pair = [
            topic for topic in self.inputs.last if topic is not topics.NOISE_VARIANCE
        ]
        if (
            timing.apart
            and now - self.watch.last >= NANOSECONDS
            and all(self.inputs.age(topic) <= 1.0 for topic in pair)
        ):
            yield self._warn(
                'apart',
                (
                    f'{" and ".join(topic.name for topic in pair)} come, but their stamps are '
                    f'{abs(timing.apart) * 1e-6:.6g} ms apart: expected at most '
                    f'{timing.tolerance * 1e-6:g} ms (pair_tolerance), of one clock'
                ),
            )
        turns, samples, stamp = self._reported_at
        self._reported_at = self.watch.intervals.count, self.samples, timing.last_stamp
        turned, new = self.watch.intervals.count - turns, self.samples - samples
        elapsed = (timing.last_stamp - stamp) / NANOSECONDS
        if new == 0 and turned >= FEWEST:
            yield self._warn(
                'rate',
                'samples come, but all with the same stamp: expected that '
                'of each, of one clock',
            )
        expected = config.rate * elapsed
        if (
            stamp >= 0
            and new >= FEWEST
            and elapsed > 0.0
            and not (expected / WRONG_RATE < new < expected * WRONG_RATE)
        ):
            yield self._warn(
                'rate',
                f'samples come at {new / elapsed:.4g} Hz by their stamps: '
                f'expected {config.rate:g} Hz',
            )

    def _publishers(self) -> Iterator[ComponentStatus | None]:
        """Yield how many publish each input and command; warn with names where several do."""
        counted = yield from self._node.background.compute(self._count_publishers)
        nodes = counted.result()
        several = '; '.join(
            f'{name} has {counts.total()} publishers, expected 1: {_with_counts(counts)}'
            for name, counts in nodes.items()
            if counts.total() > 1
        )
        yield ComponentStatus(
            'publishers',
            {name: counts.total() for name, counts in nodes.items()},
            self._warn('publishers', several),
        )

    def _count_publishers(self) -> dict[str, Counter[str]]:
        """Return how often each node publishes, by the name of each input and of the command."""
        return {
            name: Counter(
                x.node_name
                for x in self._node.get_publishers_info_by_topic(
                    self._node.resolve_topic_name(name)
                )
            )
            for name in self._owned
        }

    def _supervisor(self) -> Iterator[ComponentStatus | None]:
        """Yield what the supervisor does, and in how many ticks it did something else."""
        friction = yield from self._node.background.compute(
            self._loop.supervisor.explanations.friction
        )
        status, log = self._loop.status or QUIET, self._loop.events
        severe = SEVERITY.index(status.reaction) > SEVERITY.index(INFLATE)
        trouble = self._reaction() or friction.result()
        if status.unwatched:
            trouble = f'{trouble}; {status.unwatched}' if trouble else status.unwatched
        yield ComponentStatus(
            'supervisor',
            {
                'reaction': status.reaction,
                'causes': ' '.join(status.causes) or 'none',
                'task_time_s': self._loop.supervisor.task_time,
                'events': len(log.events),
                **log.collisions,
                **{
                    f'{what} {name}': count
                    for what, counts in (
                        ('ticks with', log.reaction_counts),
                        ('rejected', log.rejected_counts),
                        ('limited', log.limit_counts),
                    )
                    for name, count in counts.items()
                    if name != NONE
                },
            },
            **{'error' if severe else 'warning': trouble},
        )

    def _reaction(self) -> str:
        """Return what the supervisor does instead of control, and why; empty if nothing."""
        status, supervisor = self._loop.status or QUIET, self._loop.supervisor
        causes = ', '.join(status.causes)
        if status.reaction in (NONE, INFLATE):
            return f'R is inflated: {causes}' if status.reaction == INFLATE else ''
        return '; '.join(
            (f'{status.reaction} instead of control: {causes}', *supervisor.findings)
        )

    def _contacts(self) -> Iterator[ComponentStatus | None]:
        """Yield the states of the contacts and R [N^2]; their forces are on topics."""
        loop, output, config = self._loop, self._loop.output, self._loop.config
        values: dict[str, Any] = {'held': loop.held}
        if output is None:
            yield ComponentStatus('contacts', values)
            return
        unreadable = yield from self._node.background.compute(
            _hard_to_read, config, output
        )
        trouble: list[str] = []
        if self._timing.variance is not None:
            variances = dict(zip(config.column_names, self._timing.variance.tolist()))
            values |= {
                f'{name} noise_variance_n2': each for name, each in variances.items()
            }
            bounds = config.noise_variance
            trouble += [
                f'R of {name} is at a bound: expected {bounds.smallest:g} to {bounds.largest:g} '
                f'N^2 (noise_variance), got {each:.3g} N^2'
                for name, each in variances.items()
                if not bounds.smallest < each < bounds.largest
            ]
        states = dict(
            zip(
                config.contact_names,
                loop.status.contact_states
                if loop.status
                else [
                    'force' if output.answer['active'][i] else 'motion'
                    for i in config.leaders
                ],
            )
        )
        trouble += loop.status.read_before if loop.status else ()
        trouble += unreadable.result()
        trouble += [
            f'{name} is {state}' for name, state in states.items() if state in TROUBLED
        ]
        yield ComponentStatus('contacts', values | states, '; '.join(trouble))

    def _sensor(self) -> Iterator[ComponentStatus | None]:
        """Yield the health of the wrist sensor, and what is still to be proved of it."""
        gate, supervisor = self._loop.push_gate, self._loop.supervisor
        felt = yield from self._node.background.compute(
            supervisor.explanations.stray_force
        )
        stray = '' if gate.running else felt.result()
        if stray:
            self._warn('stray', stray)
        fault = supervisor.inputs.sensor_fault
        failed = gate.result is not None and not gate.result.passed and not gate.running
        yield ComponentStatus(
            'sensor',
            {
                'fault': fault or 'none',
                'push_test': gate.instruction or 'none',
                'force_control': 'allowed' if gate.open else 'disabled',
            },
            gate.instruction if gate.running or not gate.open else stray,
            f'the readings are {fault}'
            if fault
            else gate.instruction
            if failed
            else '',
        )


def _hard_to_read(config: ControllerConfig, output: ControlOutput) -> list[str]:
    """Return which forces friction or the noise of the sensor spoil with the tool as it is."""
    trouble = [
        f'1 N of friction at {where} is read as {gain:.1f} N at {what}: give '
        f'contacts.{where}.friction_std'
        for where, what, gain in find_misread_friction(
            config, output.contacts, output.pose.rotation_world
        )
    ]
    noisy = resolutions(config, output.controls, output.contacts)
    trouble += [
        f'the noise of {each} is above 1/{SPREAD:g} of {each.field} with the tool turned as it is'
        for each in noisy
        if not each.suffices
    ]
    return trouble


def _with_counts(counts: Mapping[str, int]) -> str:
    """Return names in order, with how many of each there are; one may have just ended."""
    return ', '.join(
        f'{name} ({count} times, as if started again)' if count > 1 else name
        for name, count in sorted(counts.items())
    )
