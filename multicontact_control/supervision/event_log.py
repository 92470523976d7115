"""What a supervisor did in a run, and when."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.supervision.gate import NAMES
from multicontact_control.supervision.status import SupervisorStatus

CAPACITY = 1000  # a limit that comes and goes at every tick must not fill the memory
LIMITS = ('reference', *(name for name, _ in NAMES))


class Event(NamedTuple):
    """
    One line of the log, taken apart.

    Attributes
    ----------
    time
        When it came to be so [s].
    reaction
        As in `SupervisorStatus`.
    causes
        What called for it.
    limits
        Limits that are enforced.
    contact_states
        State of each contact.

    """

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
    """
    Notes what changes in what a supervisor reports.

    Attributes
    ----------
    events
        Time [s] and what changed, the first `CAPACITY` of them.
    dropped
        How many came after these.

    """

    def __init__(self) -> None:
        self.events: list[tuple[float, str]] = []
        self.dropped = 0
        self._before: tuple[object, ...] = ()

    def note(self, time: float, status: SupervisorStatus) -> None:
        """Take in the status of one tick."""
        now = (status.reaction, status.causes, status.limits, status.contact_states)
        if now == self._before:
            return
        self._before = now
        if len(self.events) == CAPACITY:
            self.dropped += 1
            return
        self.events.append((time, ' | '.join([
            status.reaction, ' '.join(status.causes + status.limits),
            ', '.join(status.contact_states)])))
