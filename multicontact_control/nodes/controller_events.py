"""What becomes of a controller, told when it happens: in its log, and on ~/status."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from multicontact_control.control_loop import ControlLoop
from multicontact_control.nodes import topics
from multicontact_control.nodes.controller_status import reaction_text
from multicontact_control.nodes.graph_node import create_publisher
from multicontact_control.nodes.status_message import ACCEPTED, ControllerStatus, REFUSED, STATE
from multicontact_control.supervision.reactions import NONE
from rclpy.node import Node

REPEAT_TIME = 5_000_000_000  # ns, in which a line is logged once
STATE_INTERVAL = 20_000_000  # ns, between two messages on a state that changes
ANSWER_INTERVAL = 100_000_000  # ns, between two equal answers: motions come at the control rate


class ControllerEvents:
    """
    Tells what becomes of commands, and what a controller does instead of what it is asked for.

    Each answer to a command and each change of state is a `ControllerStatus` on ~/status. A
    command with an identifier is answered; one without is told of if it is refused. The state is
    repeated once a second.

    Parameters
    ----------
    node, loop
        The controller's node, and what it steps.
    life_cycle
        Returns the state of its life cycle.

    """

    def __init__(self, node: Node, loop: ControlLoop, life_cycle: Callable[[], str]) -> None:
        self._node, self._loop, self._life_cycle = node, loop, life_cycle
        self._log_due: dict[str, int] = {}
        self.publisher = create_publisher(node, topics.STATUS)
        self._before: tuple[Any, ...] = ()
        self._reacting = False
        self._next_state = self._next_answer = 0
        self._answered: tuple[str, str, bool] | None = None
        self._refused = 0

    def close(self) -> None:
        """Free the topic."""
        self._node.destroy_publisher(self.publisher)

    def answer(self, source: str, identifier: str = '', error: Exception | None = None) -> None:
        """Tell whether a command on a topic or of a service is accepted, or why it is refused."""
        self._refused += error is not None
        answer, now = (source, identifier, error is None), time.monotonic_ns()
        if (identifier or error is not None) and (
                answer != self._answered or now >= self._next_answer):
            self._answered, self._next_answer = answer, now + ANSWER_INTERVAL
            self._publish(ACCEPTED if error is None else REFUSED, identifier,
                          '' if error is None else f'{source}: {error}')

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
        if now == self._before or time.monotonic_ns() < self._next_state:
            return
        if status is not None and now[:2] != self._before[:2]:
            reacting, self._reacting = self._reacting, status.reaction != NONE
            if self._reacting:
                self._warn(f'{status.reaction} {status.causes}', reaction_text(loop))
            elif reacting:
                self._node.get_logger().info(
                    'control goes on', throttle_duration_sec=REPEAT_TIME * 1e-9)
        self._before = now
        self.repeat()

    def _warn(self, kind: str, text: str) -> None:
        """Log what may happen at every tick, each kind of it once in `REPEAT_TIME`."""
        now = time.monotonic_ns()
        if now >= self._log_due.get(kind, 0):
            self._log_due[kind] = now + REPEAT_TIME
            self._node.get_logger().warning(text)

    def repeat(self) -> None:
        """Tell the state."""
        self._next_state = time.monotonic_ns() + STATE_INTERVAL
        self._publish(STATE)

    def _publish(self, event: str, identifier: str = '', refusal: str = '') -> None:
        loop, status, reaction = self._loop, self._loop.status, reaction_text(self._loop)
        text = refusal or reaction or loop.push_gate.instruction or (
            'safe behaviour' if loop.safe else 'held' if loop.held else 'ok')
        states = zip(loop.config.contact_names, status.contact_states) if status else ()
        self.publisher.publish(ControllerStatus(
            event=event, command=identifier, text=text, life_cycle=self._life_cycle(),
            reaction=status.reaction if status else NONE,
            causes=' '.join(status.causes) if status else '',
            contacts=', '.join(f'{name} {state}' for name, state in states),
            held=loop.held, refused=self._refused, push_test=loop.push_gate.instruction,
            forces=loop.commanded_forces).message(
                f'{self._node.get_name()}: status',
                DiagnosticStatus.WARN if refusal or reaction else DiagnosticStatus.OK))
