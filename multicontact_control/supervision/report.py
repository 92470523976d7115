"""What a supervisor reports: of every tick, and of a whole run."""

from __future__ import annotations

from collections import Counter, deque
from typing import Any, NamedTuple

from multicontact_control.control.controller import ControlOutput
from multicontact_control.records import CONTACT, CONTROL
from multicontact_control.supervision.causes import COLLISION, NAMES
import numpy as np

EVENT_CAPACITY = 1000  # a limit that comes and goes at every tick fills no memory


class SupervisorStatus(NamedTuple):
    """What the supervisor did in a tick, and why; the same object as long as nothing changes."""

    # ``none``, ``inflate`` (R), or ``hold``, ``float``, ``damp`` in place of the law.
    reaction: str
    causes: tuple[str, ...] = ()  # what called for it
    rejected: tuple[str, ...] = ()  # what was wrong with readings of this tick
    limits: tuple[str, ...] = ()  # that were enforced
    contact_states: tuple[str, ...] = ()
    unwatched: str = ''  # whose torques are of no use, and what is unwatched therefore
    read_before: tuple[str, ...] = ()  # what was read before a touch, in words


def make_empty_answer(joints: int, contacts: int) -> ControlOutput:
    """
    Return the answer before anything is known: no torque, and records of zeros.

    Its frame and task have the axes of the world, so that they are rotations.
    """
    controls = np.zeros(1, dtype=CONTROL)
    controls['frame']['rotation'] = np.eye(3)
    controls['task']['rotation'] = np.eye(3)
    unknown = np.zeros(contacts, dtype=CONTACT)
    return ControlOutput(np.zeros(joints), controls.tobytes() + unknown.tobytes())


class EventLog:
    """
    Counts what a supervisor does, and notes what changes.

    Attributes
    ----------
    events
        Time [s] and what changed: the last ones, since these have the cause of the end.
    repeats
        Ticks with the status of the last `note_status`, itself counted.
    collisions
        Beginnings of them, by cause.

    """

    def __init__(self) -> None:
        self.events: deque[tuple[float, str]] = deque(maxlen=EVENT_CAPACITY)
        self.collisions: Counter[str] = Counter()
        self.repeats = 0
        self._status = SupervisorStatus('')  # of the newest tick
        self._reactions: Counter[str] = Counter()
        self._rejected: Counter[str] = Counter()
        self._limits: Counter[str] = Counter()

    @property
    def reaction_counts(self) -> Counter[str]:
        """In how many ticks there was each reaction."""
        self._count_repeats()
        return self._reactions

    @property
    def rejected_counts(self) -> Counter[str]:
        """In how many ticks a reading was not used, by what was wrong with it."""
        self._count_repeats()
        return self._rejected

    @property
    def limit_counts(self) -> Counter[str]:
        """In how many ticks each limit was enforced."""
        self._count_repeats()
        return self._limits

    def _count_repeats(self) -> None:
        """Count the ticks of the newest status that have not been counted."""
        ticks, status = self.repeats, self._status
        self.repeats = 0
        if ticks == 0:
            return
        self._reactions[status.reaction] += ticks
        for fault in status.rejected:
            self._rejected[fault] += ticks
        for limit in status.limits:
            self._limits[limit] += ticks

    def note_status(self, time: float, status: SupervisorStatus) -> None:
        """Take in the status of a tick that is not as the one before, at a time [s]."""
        self._count_repeats()
        before, self._status, self.repeats = self._status, status, 1
        if _what_happens(status) == _what_happens(before):
            return
        for cause in status.causes:
            if cause.startswith(NAMES[COLLISION]) and cause not in before.causes:
                self.collisions[cause] += 1
        parts = [
            status.reaction,
            ' '.join(status.causes + status.limits),
            ', '.join(status.contact_states),
            *status.read_before,
        ]
        self.events.append((time, ' | '.join(parts)))


def _what_happens(status: SupervisorStatus) -> tuple[Any, ...]:
    """Return what of a status is an event if it changes; what is read changes all the time."""
    return (
        status.reaction,
        status.causes,
        status.limits,
        status.contact_states,
        len(status.read_before),
    )
