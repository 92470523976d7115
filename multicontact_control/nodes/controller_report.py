"""What the controller says of itself: ~/status and its log at once, diagnostics each second."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
import time
from typing import Any, NamedTuple

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
from multicontact_control.nodes.lifecycle import ACTIVE, CONFIGURED, ManagedNode
from multicontact_control.nodes.messages import (
    ACCEPTED,
    ControllerStatus,
    REFUSED,
    STATE,
)
from multicontact_control.sampling import NANOSECONDS, SampleTiming
from multicontact_control.supervision.causes import INFLATE, NONE, SEVERITY
from multicontact_control.supervision.contacts import (
    GIVEN_UP,
    LOST,
    RETRACTING,
    STATE_NAMES,
)
from multicontact_control.supervision.report import SupervisorStatus
from rclpy.serialization import serialize_message

LOG_INTERVAL = 5 * NANOSECONDS  # ns, between two warnings of one kind
STATE_INTERVAL = 20_000_000  # ns, between two messages on a state that changes
# ns, between two equal answers: motions are commanded at the control rate.
ANSWER_INTERVAL = 100_000_000
TROUBLED_STATES = (STATE_NAMES[LOST], STATE_NAMES[RETRACTING], STATE_NAMES[GIVEN_UP])
FEWEST_SAMPLES = 10  # from which a rate is known
WRONG_RATE_FACTOR = 1.3  # between the rate of the stamps and that of the configuration
NO_STATUS = SupervisorStatus(NONE)  # before the first sample, and bare


@dataclass(frozen=True)
class CommandAnswer:
    """The controller's answer to one command on a topic, or to one request of a service."""

    source: str  # name of the topic or service
    identifier: str = ''  # that the sender gave to the command; empty for none
    refusal: str = ''  # why it is refused; empty if it is accepted
    left_out: str = ''  # the part of an accepted command that is not obeyed

    @property
    def event(self) -> str:
        """Return the event on ~/status: refused, accepted, or a state without command."""
        if not self.source:
            return STATE
        return REFUSED if self.refusal else ACCEPTED


NO_COMMAND = CommandAnswer('')


class ReportedState(NamedTuple):
    """What ~/status tells of the newest tick; a change of any field is worth a message."""

    status: SupervisorStatus = NO_STATUS  # without what may change at every tick
    misread_contacts: int = 0  # contacts of which a force is read before a touch
    findings: tuple[str, ...] = ()
    instruction: str = ''  # of the push test
    safe: bool = False
    held: bool = False
    life_cycle: str = ''
    forces: tuple[float, ...] = ()  # commanded [N]

    # Of one that is followed: moving, waiting or held, and percent.
    trajectory: str = ''

    @property
    def reaction(self) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
        """Return the reaction, its causes, and what exceptions have said."""
        return self.status.reaction, self.status.causes, self.findings


class SampleCount(NamedTuple):
    """Samples up to a report: how many came, how many had a new stamp, and the newest stamp."""

    turns: int
    samples: int
    stamp: int  # ns, -1 before the first


class ControllerReport:
    """
    Says what becomes of commands, what the controller does, and which inputs are bad.

    Parameters
    ----------
    node, loop, timing
        The node that speaks, the control loop and the timing of samples that it speaks of.
    inputs
        Topics of the readings; their ages and publishers are reported.
    may_pause
        Whether the robot may stop sending, as in lockstep, so that silence is no fault.

    Attributes
    ----------
    samples, restarts
        Samples with another stamp than the one before; how often samples have begun anew.
    watch
        Its turns are samples; a latency lasts from the newest message of a sample to the command.

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
        self._node = node
        self._loop = loop
        self._timing = timing
        self._owned_topics = [topic.name for topic in inputs]
        self._owned_topics.append(topics.EFFORT_COMMAND.name)
        bare_efforts = node.parameter_set.present_value('effort_output_topic')
        if bare_efforts:
            self._owned_topics.append(bare_efforts)
        self.inputs = InputMonitor(node, loop.config.rate, *inputs, may_pause=may_pause)
        self.watch = LoopStatistics(loop.config.rate)
        self._publisher = create_publisher(node, topics.STATUS)
        self.samples = self.restarts = 0
        self._refused_commands = 0
        self._published_statuses = 0
        self._state_due = self._answer_due = 0
        self._log_due: dict[str, int] = {}  # by kind of warning, monotonic time [ns]
        self._last_state = ReportedState()
        self._last_answer: tuple[Any, ...] = ()
        self._last_count = SampleCount(0, 0, -1)

    @property
    def _status(self) -> SupervisorStatus:
        return self._loop.status or NO_STATUS

    def report_answer(self, answer: CommandAnswer) -> None:
        """
        Tell on ~/status whether a command is accepted or refused, and log what is left out of it.

        An accepted command without an identifier is not answered, since its sender cannot tell
        the answer from others. Answers of one kind that follow each other within
        `ANSWER_INTERVAL` are published once.
        """
        if self._node.state not in CONFIGURED:
            return  # the command was on its way when its subscription was destroyed
        if answer.refusal:
            self._refused_commands += 1
        if answer.left_out:
            text = f'{answer.source}: {answer.left_out}'
            self._warn(f'left out {answer.source}', text)
        if not (answer.identifier or answer.refusal):
            return
        kind = (
            answer.source,
            answer.identifier,
            bool(answer.refusal),
            bool(answer.left_out),
        )
        now = time.monotonic_ns()
        if kind != self._last_answer or now >= self._answer_due:
            self._last_answer = kind
            self._answer_due = now + ANSWER_INTERVAL
            self._publish_status(answer)

    def report_changes(self) -> None:
        """
        Log and publish the changes of the newest tick since the last message on the state.

        Called after every tick: two messages on the state are `STATE_INTERVAL` apart at least.
        """
        status = self._status
        for fault in status.rejected:
            self._warn(fault, f'a reading is not used: {fault}')
        self._warn('read before', '; '.join(status.read_before))
        state = self._present_state()
        if state == self._last_state or time.monotonic_ns() < self._state_due:
            return
        self._log_changes(self._last_state, state)
        self._last_state = state
        self._state_due = time.monotonic_ns() + STATE_INTERVAL
        self._publish_status()

    def _present_state(self) -> ReportedState:
        loop = self._loop
        status = self._status
        return ReportedState(
            status._replace(rejected=(), limits=(), read_before=()),
            len(status.read_before),
            loop.supervisor.findings,
            loop.push_gate.instruction,
            loop.supervisor.safe,
            loop.held,
            self._node.state,
            tuple(loop.commanded_forces.values()),
            self._describe_trajectory(with_seconds=False),
        )

    def _log_changes(self, before: ReportedState, state: ReportedState) -> None:
        """Log which of reaction, contacts, efforts and push test have changed."""
        status = state.status
        # Inactive, no reaction ends in control: the node says itself what it commands.
        if state.reaction != before.reaction and not state.safe:
            kind = f'{status.reaction} {status.causes} {bool(state.findings)}'
            self._warn(kind, self._describe_reaction() or 'control goes on')
        if status.contact_states != before.status.contact_states:
            names = self._loop.config.contact_names
            for name, contact_state in zip(names, status.contact_states):
                if contact_state == STATE_NAMES[GIVEN_UP]:
                    self._warn(
                        f'given up {name}',
                        f'{name}: given up, until it is commanded or '
                        'sought again (contact_state.retry_time, force_ceiling)',
                    )
        if status.unwatched != before.status.unwatched:
            recovered = 'effort in joint_states: of use in all joints again'
            self._warn(f'unwatched {status.unwatched}', status.unwatched or recovered)
        if state.instruction not in ('', before.instruction):
            self._node.get_logger().info(f'push test: {state.instruction}')

    def _warn(self, kind: str, text: str) -> str:
        """Log a warning, if there is one, each kind once per `LOG_INTERVAL`; return it."""
        now = time.monotonic_ns()
        if text and now >= self._log_due.get(kind, 0):
            self._log_due[kind] = now + LOG_INTERVAL
            self._node.get_logger().warning(text)
        return text

    def _publish_status(self, answer: CommandAnswer = NO_COMMAND) -> None:
        """Publish the state on ~/status, as the answer to a command if there is one."""
        self._published_statuses += 1
        self._publisher.publish(self._prepare_status(answer)())

    def _prepare_status(
        self, answer: CommandAnswer = NO_COMMAND
    ) -> Callable[[], DiagnosticStatus]:
        """Take the present state; return the function that makes the message of it."""
        loop = self._loop
        status = self._status
        trouble = _join_texts(self._describe_reaction(), answer.left_out)
        if answer.refusal:
            trouble = f'{answer.source}: {answer.refusal}'
        readers = 0
        if answer.source:
            readers = self._node.count_subscribers(answer.source)
        contact_states = zip(loop.config.contact_names, status.contact_states)
        columns = loop.supervisor.task.placing_columns()
        state = ControllerStatus(
            event=answer.event,
            command=answer.identifier,
            text=trouble or self._describe_work(),
            life_cycle=self._node.state,
            reaction=status.reaction,
            causes=' '.join(status.causes),
            contacts=', '.join(map(' '.join, contact_states)),
            held=loop.held,
            refused=self._refused_commands,
            readers=readers,
            push_test=loop.push_gate.instruction,
            unwatched=status.unwatched,
            forces=loop.commanded_forces,
            left_out=answer.left_out,
            trajectory=self._describe_trajectory(),
            placing={name: tuple(x.tolist()) for name, x in columns.items()},
        )
        level = DiagnosticStatus.WARN if trouble else DiagnosticStatus.OK
        return partial(state.to_message, f'{self._node.get_name()}: status', level)

    def _describe_trajectory(self, *, with_seconds: bool = True) -> str:
        """Return what becomes of a trajectory, and how far it is; see `ControllerStatus`."""
        progress = self._loop.progress
        if progress is None:
            return ''
        state = 'moving'
        if self._loop.held:
            state = 'held'
        elif progress.waits or self._status.reaction not in (NONE, INFLATE):
            state = 'waiting'
        if not with_seconds:
            return f'{state} {progress.share:.2f}'
        return f'{state} {progress.share:.4f} {progress.remaining:.3f}'

    def _describe_work(self) -> str:
        """Return what the controller does while nothing troubles it, 'ok' if as commanded."""
        loop = self._loop
        if loop.push_gate.instruction:
            return loop.push_gate.instruction
        if loop.supervisor.safe:
            return 'safe behaviour'
        if loop.held:
            return 'held'
        return '; '.join(self._status.read_before) or 'ok'

    def _describe_reaction(self) -> str:
        """Return what the supervisor does instead of control, and why; empty for nothing."""
        status = self._status
        causes = ', '.join(status.causes)
        if status.reaction == NONE:
            return ''
        if status.reaction == INFLATE:
            return f'R is inflated: {causes}'
        text = f'{status.reaction} instead of control: {causes}'
        return '; '.join((text, *self._loop.supervisor.findings))

    def collect_statuses(self) -> Iterator[ComponentStatus | None]:
        """
        Yield the statuses of the diagnostics, and None where a sample may come between.

        The newest state is published on ~/status as well, for a reader that came late.
        """
        yield from self._publish_state_apart()
        yield from self._report_loop()
        last_variance_held = (
            self.inputs.age(topics.NOISE_VARIANCE) > self.inputs.max_age
        )
        yield self.inputs.status(
            needed=self._node.state == ACTIVE,
            consequence=': the last R is held' if last_variance_held else '',
        )
        yield from self._report_publishers()
        yield from self._report_contacts()
        yield from self._report_sensor()
        yield refusal_status(self._node.refusals, unpaired=self._timing.unpaired)
        if self._loop.supervisor.guarded:
            yield from self._report_supervisor()

    def _publish_state_apart(self) -> Iterator[None]:
        """Publish the state; the background thread makes the message."""
        published_before = self._published_statuses
        build_message = self._prepare_status()
        yield
        message = yield from self._node.background.compute(
            lambda: serialize_message(build_message())
        )
        if published_before == self._published_statuses:  # else a newer one is out
            self._publisher.publish(message.result())
        yield

    def _report_loop(self) -> Iterator[ComponentStatus | None]:
        """Yield rate, jitter and latency, and whether samples come as they should."""
        supervisor = self._loop.supervisor
        warnings = []
        unanswered = self._timing.skipped
        self._timing.skipped = 0
        if unanswered:
            warnings.append(f'{unanswered} samples without a command')
        if self._node.state == ACTIVE:
            warnings += [self._warn_of_unpaired_stamps(), self._warn_of_wrong_rate()]
        yield None
        statistics = yield from self._node.background.compute(self.watch.report)
        yield ComponentStatus(
            'loop',
            {
                **statistics.result(),
                'deadline_misses': unanswered,
                'steps': self.watch.latencies.count,
                'restarts': self.restarts,
                'safe_behaviour': supervisor.safe,
                'supervised': supervisor.guarded,
            },
            _join_texts(*warnings),
        )

    def _warn_of_unpaired_stamps(self) -> str:
        """Warn of joint states and wrenches that come, but with stamps that are no pair."""
        timing = self._timing
        silence = time.monotonic_ns() - self.watch.last
        if not timing.stamp_difference or silence < NANOSECONDS:
            return ''
        pair = [name for name in self.inputs.last if name is not topics.NOISE_VARIANCE]
        if any(self.inputs.age(topic) > 1.0 for topic in pair):
            return ''
        names = ' and '.join(topic.name for topic in pair)
        return self._warn(
            'apart',
            f'{names} come, but their stamps are '
            f'{abs(timing.stamp_difference) * 1e-6:.6g} ms apart: expected at most '
            f'{timing.tolerance * 1e-6:g} ms (pair_tolerance), of one clock',
        )

    def _warn_of_wrong_rate(self) -> str:
        """Warn of stamps since the last report that stand still, or have another rate."""
        count = SampleCount(
            self.watch.intervals.count, self.samples, self._timing.last_stamp
        )
        before = self._last_count
        self._last_count = count
        new = count.samples - before.samples
        if new == 0 and count.turns - before.turns >= FEWEST_SAMPLES:
            return self._warn(
                'rate',
                'samples come, but all with the same stamp: expected that '
                'of each, of one clock',
            )
        elapsed = (count.stamp - before.stamp) / NANOSECONDS
        if before.stamp < 0 or new < FEWEST_SAMPLES or elapsed <= 0.0:
            return ''
        rate = self._loop.config.rate
        expected = rate * elapsed
        if expected / WRONG_RATE_FACTOR < new < expected * WRONG_RATE_FACTOR:
            return ''
        return self._warn(
            'rate',
            f'samples come at {new / elapsed:.4g} Hz by their stamps: '
            f'expected {rate:g} Hz',
        )

    def _report_publishers(self) -> Iterator[ComponentStatus | None]:
        """Yield how many publish each input and command; warn with names where several do."""
        counted = yield from self._node.background.compute(self._count_publishers)
        totals = {}
        warnings = []
        for name, nodes in counted.result().items():
            totals[name] = nodes.total()
            if nodes.total() > 1:
                warnings.append(
                    f'{name} has {nodes.total()} publishers, expected 1: '
                    f'{_list_with_counts(nodes)}'
                )
        warning = self._warn('publishers', '; '.join(warnings))
        yield ComponentStatus('publishers', totals, warning)

    def _count_publishers(self) -> dict[str, Counter[str]]:
        """Return how often each node publishes, by the name of each input and of the command."""
        counts = {}
        for name in self._owned_topics:
            full_name = self._node.resolve_topic_name(name)
            publishers = self._node.get_publishers_info_by_topic(full_name)
            counts[name] = Counter(publisher.node_name for publisher in publishers)
        return counts

    def _report_contacts(self) -> Iterator[ComponentStatus | None]:
        """Yield the states of the contacts and R [N^2]; their forces are on topics."""
        loop = self._loop
        output = loop.output
        values: dict[str, Any] = {'held': loop.held}
        if output is None:
            yield ComponentStatus('contacts', values)
            return
        unreadable = yield from self._node.background.compute(
            _list_unreadable_forces, loop.config, output
        )
        warnings = []
        bounds = loop.config.noise_variance
        for name, variance in self._present_variances().items():
            values[f'{name} noise_variance_n2'] = variance
            if not bounds.smallest < variance < bounds.largest:
                warnings.append(
                    f'R of {name} is at a bound: expected {bounds.smallest:g} to '
                    f'{bounds.largest:g} N^2 (noise_variance), got {variance:.3g} N^2'
                )
        warnings += [*self._status.read_before, *unreadable.result()]
        for name, state in self._contact_states(output).items():
            values[name] = state
            if state in TROUBLED_STATES:
                warnings.append(f'{name} is {state}')
        yield ComponentStatus('contacts', values, '; '.join(warnings))

    def _present_variances(self) -> dict[str, float]:
        """Return the newest R by contact and couple [N^2]; empty before the first."""
        variance = self._timing.variance
        if variance is None:
            return {}
        return dict(zip(self._loop.config.column_names, variance.tolist()))

    def _contact_states(self, output: ControlOutput) -> dict[str, str]:
        """Return the state of each contact; bare, what is controlled at it."""
        config = self._loop.config
        if self._loop.status:
            return dict(zip(config.contact_names, self._loop.status.contact_states))
        states = {}
        for name, column in zip(config.contact_names, config.force_columns):
            states[name] = 'force' if output.answer['active'][column] else 'motion'
        return states

    def _report_sensor(self) -> Iterator[ComponentStatus | None]:
        """Yield the health of the wrist sensor, and what is still to be proved of it."""
        gate = self._loop.push_gate
        supervisor = self._loop.supervisor
        felt = yield from self._node.background.compute(
            supervisor.explanations.stray_force
        )
        error = ''
        if gate.running or not gate.open:
            warning = gate.instruction
        else:
            warning = felt.result()
        if not gate.running:
            self._warn('stray', felt.result())
        if supervisor.inputs.sensor_fault:
            error = f'the readings are {supervisor.inputs.sensor_fault}'
        elif gate.result is not None and not gate.result.passed and not gate.running:
            error = gate.instruction
        yield ComponentStatus(
            'sensor',
            {
                'fault': supervisor.inputs.sensor_fault or 'none',
                'push_test': gate.instruction or 'none',
                'force_control': 'allowed' if gate.open else 'disabled',
            },
            warning,
            error,
        )

    def _report_supervisor(self) -> Iterator[ComponentStatus | None]:
        """Yield the reaction and its causes, and in how many ticks each has been in force."""
        status = self._status
        log = self._loop.events
        friction = yield from self._node.background.compute(
            self._loop.supervisor.explanations.explain_friction
        )
        values = {
            'reaction': status.reaction,
            'causes': ' '.join(status.causes) or 'none',
            'task_time_s': self._loop.supervisor.task_time,
            'events': len(log.events),
            **log.collisions,
        }
        for kind, counts in (
            ('ticks with', log.reaction_counts),
            ('rejected', log.rejected_counts),
            ('limited', log.limit_counts),
        ):
            for name, count in counts.items():
                if name != NONE:
                    values[f'{kind} {name}'] = count
        trouble = self._describe_reaction() or friction.result()
        trouble = _join_texts(trouble, status.unwatched)
        if SEVERITY.index(status.reaction) > SEVERITY.index(INFLATE):
            yield ComponentStatus('supervisor', values, error=trouble)
        else:
            yield ComponentStatus('supervisor', values, warning=trouble)


def _join_texts(*texts: str) -> str:
    """Return what is said of several things, without those of which nothing is said."""
    return '; '.join(filter(None, texts))


def _list_unreadable_forces(
    config: ControllerConfig, output: ControlOutput
) -> list[str]:
    """Return which forces friction or the noise of the sensor spoil with the tool as it is."""
    warnings = []
    rotation = output.pose.rotation_world
    for name, column, gain in find_misread_friction(config, output.contacts, rotation):
        warnings.append(
            f'1 N of friction at {name} is read as {gain:.1f} N at {column}: give '
            f'contacts.{name}.friction_std'
        )
    for each in resolutions(config, output.controls, output.contacts):
        if not each.suffices:
            warnings.append(
                f'the noise of {each} is above 1/{SPREAD:g} of {each.field} '
                'with the tool turned as it is'
            )
    return warnings


def _list_with_counts(counts: Mapping[str, int]) -> str:
    """Return names in order; a node that appears several times may have just been restarted."""
    names = []
    for name, count in sorted(counts.items()):
        if count > 1:
            name = f'{name} ({count} times, as if started again)'
        names.append(name)
    return ', '.join(names)
