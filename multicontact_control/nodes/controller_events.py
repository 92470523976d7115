"""What becomes of a controller, told when it happens: in its log, and on ~/status."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from multicontact_control.control_loop import ControlLoop
from multicontact_control.nodes import topics
from multicontact_control.nodes.graph_node import create_publisher
from multicontact_control.supervision.fallback import INFLATE, NONE, SEVERITY
from rclpy.node import Node

REPEAT_TIME = 5_000_000_000  # ns, in which a line is logged once
LEAST_INTERVAL = 20_000_000  # ns, between two messages: a client may send at the control rate
COMMANDS = (topics.FORCE_COMMAND.name, topics.MOTION_COMMAND.name, '~/')
STATE, REFUSED = 'state', 'refused'


class ControllerEvents:
    """
    Tells what a controller does instead of what it is asked for.

    Every command that is refused and every change of state is a message on ~/status: level, text,
    and in its values what happened (`event`: ``refused`` or ``state``), the state, how many
    commands were refused so far, the last of them, and the forces that are obeyed. The state is
    repeated once a second.

    Parameters
    ----------
    node
        The controller's node.
    loop
        What it steps.
    life_cycle
        Returns the state of its life cycle.

    Attributes
    ----------
    publisher
        Of ~/status.

    """

    def __init__(self, node: Node, loop: ControlLoop, life_cycle: Callable[[], str]) -> None:
        self._node, self._loop, self._life_cycle = node, loop, life_cycle
        self._log_due: dict[str, int] = {}
        self.publisher = create_publisher(node, topics.STATUS)
        self._before: tuple[Any, ...] = ()
        self._reacting = False
        self._next = {STATE: 0, REFUSED: 0}
        self._refused = 0
        self._last_refusal = ''

    def close(self) -> None:
        """Free the topic."""
        self._node.destroy_publisher(self.publisher)

    def refused(self, source: str, error: Exception) -> None:
        """Tell of a command that is refused; of other refusals the log and the counts do."""
        if not source.startswith(COMMANDS):
            return
        self._refused += 1
        self._last_refusal = f'{source}: {error}'
        self._publish(REFUSED, DiagnosticStatus.WARN, self._last_refusal)

    def look(self) -> None:
        """Tell what has changed with the newest tick, if anything has."""
        loop = self._loop
        status = loop.status
        now = (None, (), ()) if status is None else (
            status.reaction, status.causes, status.contact_states)
        now = (*now, loop.safe, loop.held, loop.push_gate.instruction, self._life_cycle(),
               *loop.commanded_forces.values())
        if status is not None and status.rejected:
            for name in status.rejected:
                self._warn(name, f'a reading is not used: {name}')
        if now == self._before or time.monotonic_ns() < self._next[STATE]:
            return
        if status is not None and now[:2] != self._before[:2]:
            self._log_reaction(status.reaction, status.causes)
        self._before = now
        self.repeat()

    def _log_reaction(self, reaction: str, causes: tuple[str, ...]) -> None:
        reacting, self._reacting = self._reacting, reaction != NONE
        if self._reacting:
            self._warn(f'{reaction} {causes}', self._reaction())
        elif reacting:
            self._node.get_logger().info(
                'control goes on', throttle_duration_sec=REPEAT_TIME * 1e-9)

    def _warn(self, kind: str, text: str) -> None:
        """Log what may happen at every tick, each kind of it once in `REPEAT_TIME`."""
        now = time.monotonic_ns()
        if now >= self._log_due.get(kind, 0):
            self._log_due[kind] = now + REPEAT_TIME
            self._node.get_logger().warning(text)

    def _reaction(self) -> str:
        """Say what the supervisor does instead of control, and why; empty if nothing."""
        status, supervisor = self._loop.status, self._loop.supervisor
        if status is None or status.reaction == NONE:
            return ''
        causes = ', '.join(status.causes)
        if SEVERITY.index(status.reaction) <= SEVERITY.index(INFLATE):
            return f'R is inflated: {causes}'
        outside = supervisor.outside if supervisor is not None else ()
        if outside:
            return ('control does not start, the arm is held until it is inside its limits: '
                    + '; '.join(outside))
        return f'{status.reaction} instead of control: {causes}'

    def repeat(self) -> None:
        """Tell the state."""
        reaction, loop = self._reaction(), self._loop
        text = reaction or loop.push_gate.instruction or (
            'safe behaviour' if loop.safe else 'held' if loop.held else 'ok')
        self._publish(STATE, DiagnosticStatus.WARN if reaction else DiagnosticStatus.OK, text)

    def _publish(self, event: str, level: bytes, text: str) -> None:
        now = time.monotonic_ns()
        if event == REFUSED and now < self._next[REFUSED]:
            return  # it is counted, and the state says so
        self._next[event] = now + LEAST_INTERVAL
        loop, status = self._loop, self._loop.status
        states = zip(loop.config.contact_names, status.contact_states) if status else ()
        values = {
            'event': event, 'life_cycle': self._life_cycle(),
            'reaction': status.reaction if status else 'none',
            'causes': ' '.join(status.causes) if status else '',
            'contacts': ', '.join(f'{name} {state}' for name, state in states),
            'held': str(loop.held), 'push_test': loop.push_gate.instruction,
            'refused': str(self._refused), 'last_refusal': self._last_refusal,
            'forces': ', '.join(
                f'{name} {force:.9g}' for name, force in loop.commanded_forces.items())}
        self.publisher.publish(DiagnosticStatus(
            name=f'{self._node.get_name()}: status', level=level, message=text,
            values=[KeyValue(key=key, value=value) for key, value in values.items()]))
