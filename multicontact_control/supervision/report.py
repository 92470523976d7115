"""What a supervisor reports: of every tick, and of a whole run."""

from __future__ import annotations

from collections import Counter, deque
from typing import Any, NamedTuple

from multicontact_control.control.controller import ControlOutput
from multicontact_control.records import CONTACT, CONTROL
from multicontact_control.supervision.checks import COLLISION
import numpy as np

CAPACITY = 1000  # events; a limit that comes and goes at every tick must not fill the memory


class SupervisorStatus(NamedTuple):
    """What the supervisor did in a tick, and why."""

    reaction: str  # ``none``, ``inflate`` (R), or ``hold``, ``float``, ``damp`` for the law
    causes: tuple[str, ...]  # what called for it
    rejected: tuple[str, ...]  # what was wrong with readings, whether it called for it or not
    limits: tuple[str, ...]  # that were enforced
    contact_states: tuple[str, ...]
    task_time: float  # which stands still during a reaction [s]
    unwatched: str = ''  # whose measured torques are of no use, and what is not watched therefore
    read_before: tuple[str, ...] = ()  # what was read of contacts before a touch, in words


def no_answer(joints: int, contacts: int) -> ControlOutput:
    """Return the answer before anything is known."""
    controls = np.zeros(1, dtype=CONTROL)
    controls['frame']['rotation'] = controls['task']['rotation'] = np.eye(3)
    return ControlOutput(np.zeros(joints), np.zeros(contacts, dtype=CONTACT), controls)


class EventLog:
    """Counts what a supervisor does, and notes what changes."""

    def __init__(self) -> None:
        # Time [s] and what changed: the last ones, since these have the cause of the end.
        self.events: deque[tuple[float, str]] = deque(maxlen=CAPACITY)
        self.reactions: Counter[str] = Counter()  # ticks with each
        self.rejected: Counter[str] = Counter()  # ticks with each
        self.limited: Counter[str] = Counter()  # ticks with each
        self.collisions: Counter[str] = Counter()  # beginnings of them, by cause
        self._before: tuple[Any, ...] = ('', ())

    def note(self, time: float, status: SupervisorStatus) -> None:
        """Take in the status of one tick, at a time [s]."""
        self.reactions[status.reaction] += 1
        if status.rejected:
            self.rejected.update(status.rejected)
        if status.limits:
            self.limited.update(status.limits)
        now = (status.reaction, status.causes, status.limits, status.contact_states,
               len(status.read_before))
        if now == self._before:
            return
        self.collisions.update(cause for cause in status.causes if cause.startswith(COLLISION)
                               and cause not in self._before[1])
        self._before = now
        self.events.append((time, ' | '.join([
            status.reaction, ' '.join(status.causes + status.limits),
            ', '.join(status.contact_states), *status.read_before])))
