"""What a supervisor reports: of every tick, and of a whole run."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from typing import NamedTuple

from multicontact_control.control.tick import ControlOutput
from multicontact_control.records import CONTACT, CONTROL
from multicontact_control.supervision.checks import COLLISION
from multicontact_control.supervision.gate import NAMES
from multicontact_control.supervision.reactions import SEVERITY
import numpy as np

CAPACITY = 1000  # events; a limit that comes and goes at every tick must not fill the memory
ALTERNATION_TIME, FASTEST_ALTERNATION = 5.0, 2.0  # s and 1/s, beyond which something alternates
MOST_CHANGES = 500  # that are remembered
REACTION = 'reaction'
LIMITS = ('reference', *(name for name, _ in NAMES))


class SupervisorStatus(NamedTuple):
    """What the supervisor did in a tick, and why."""

    reaction: str  # ``none``, ``inflate`` (R), or ``hold``, ``float``, ``damp`` for the law
    causes: tuple[str, ...]  # what called for it
    rejected: tuple[str, ...]  # what was wrong with readings, whether it called for it or not
    limits: tuple[str, ...]  # that were enforced
    contact_states: tuple[str, ...]
    task_time: float  # which stands still during a reaction [s]


def no_answer(joints: int, contacts: int) -> ControlOutput:
    """Return the answer before anything is known."""
    controls = np.zeros(1, dtype=CONTROL)
    controls['frame']['rotation'] = controls['task']['rotation'] = np.eye(3)
    return ControlOutput(np.zeros(joints), np.zeros(contacts, dtype=CONTACT), controls)


class Event(NamedTuple):
    """A line of the log taken apart: its time [s], and the fields of `SupervisorStatus`."""

    time: float
    reaction: str
    causes: tuple[str, ...]
    limits: tuple[str, ...]
    contact_states: tuple[str, ...]


def read_event(time: float, what: str) -> Event:
    """Return what a line of the log says."""
    reaction, reasons, states = what.split(' | ')
    names = reasons.split()
    return Event(
        time, reaction, tuple(name for name in names if name not in LIMITS),
        tuple(name for name in names if name in LIMITS), tuple(states.split(', ')))


class EventLog:
    """Counts what a supervisor does, and notes what changes."""

    def __init__(self, contact_names: Sequence[str] = ()) -> None:
        self.events: list[tuple[float, str]] = []  # time [s] and what changed, the first ones
        self.dropped = 0  # those that came after `CAPACITY`
        self.reactions: Counter[str] = Counter()  # ticks with each
        self.rejected: Counter[str] = Counter()  # ticks with each
        self.limited: Counter[str] = Counter()  # ticks with each
        self.collisions: Counter[str] = Counter()  # beginnings of them, by cause
        self.names = (REACTION, *contact_names)  # of what has states
        self._before: tuple[object, ...] = ()
        self._touched = False
        self._states: tuple[str, ...] = ()
        self._time, self._passed = 0.0, 0.0
        self._changes: dict[str, deque[float]] = {
            name: deque(maxlen=MOST_CHANGES) for name in self.names}

    def note(self, time: float, status: SupervisorStatus) -> None:
        """Take in the status of one tick, at a time [s]."""
        self._passed += max(time - self._time, 0.0)  # also over a clock that is set back
        self._time = time
        self.reactions[status.reaction] += 1
        if status.rejected:
            self.rejected.update(status.rejected)
        if status.limits:
            self.limited.update(status.limits)
        now = (status.reaction, status.causes, status.limits, status.contact_states)
        if now == self._before:
            return
        touched = [cause for cause in status.causes if cause.startswith(COLLISION)]
        if touched and not self._touched:
            self.collisions[touched[0]] += 1
        self._before, self._touched = now, bool(touched)
        self._count((status.reaction, *status.contact_states))
        if len(self.events) == CAPACITY:
            self.dropped += 1
            return
        self.events.append((time, ' | '.join([
            status.reaction, ' '.join(status.causes + status.limits),
            ', '.join(status.contact_states)])))

    def _count(self, states: tuple[str, ...]) -> None:
        """Count changes of state; a reaction that becomes more severe counts for its way back."""
        for name, before, state in zip(self.names, self._states, states):
            if name != REACTION:
                self._changes[name].extend([self._passed] * (state != before))
            elif SEVERITY.index(state) > SEVERITY.index(before):
                self._changes[name].extend([self._passed] * 2)
        self._states = states

    def alternating(self, time: float) -> dict[str, float]:
        """Return what has changed more than twice a second over 5 s up to now [s], in 1/s."""
        passed = self._passed + max(time - self._time, 0.0)
        recent = {name: sum(passed - change <= ALTERNATION_TIME for change in changes)
                  for name, changes in self._changes.items()}
        return {name: count / ALTERNATION_TIME for name, count in recent.items()
                if count > FASTEST_ALTERNATION * ALTERNATION_TIME}
