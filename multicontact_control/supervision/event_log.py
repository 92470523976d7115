"""What a supervisor did in a run, and when."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from multicontact_control.supervision.fallback import SEVERITY
from multicontact_control.supervision.gate import NAMES
from multicontact_control.supervision.status import SupervisorStatus

CAPACITY = 1000  # a limit that comes and goes at every tick must not fill the memory
ALTERNATION_TIME, FASTEST_ALTERNATION = 5.0, 2.0  # s and 1/s, beyond which something alternates
MOST_CHANGES = 500  # that are remembered
REACTION = 'reaction'
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
    names
        Of what has states: the reaction and the contacts.

    """

    def __init__(self, contact_names: Sequence[str] = ()) -> None:
        self.events: list[tuple[float, str]] = []
        self.dropped = 0
        self.names = (REACTION, *contact_names)
        self._before: tuple[object, ...] = ()
        self._states: tuple[str, ...] = ()
        self._time, self._passed = 0.0, 0.0
        self._changes: dict[str, deque[float]] = {
            name: deque(maxlen=MOST_CHANGES) for name in self.names}

    def note(self, time: float, status: SupervisorStatus) -> None:
        """Take in the status of one tick."""
        # A clock that is set back begins anew: what changed is of times before, not of those.
        self._passed += max(time - self._time, 0.0)
        self._time = time
        now = (status.reaction, status.causes, status.limits, status.contact_states)
        if now == self._before:
            return
        self._before = now
        self._count((status.reaction, *status.contact_states))
        if len(self.events) == CAPACITY:
            self.dropped += 1
            return
        self.events.append((time, ' | '.join([
            status.reaction, ' '.join(status.causes + status.limits),
            ', '.join(status.contact_states)])))

    def _count(self, states: tuple[str, ...]) -> None:
        """
        Take note of what has gone over into another state.

        A reaction that becomes more severe counts for the way back, too: in how many steps it
        goes back, from `float` over `hold`, is no alternation.
        """
        for name, before, state in zip(self.names, self._states, states):
            if name != REACTION:
                self._changes[name].extend([self._passed] * (state != before))
            elif SEVERITY.index(state) > SEVERITY.index(before):
                self._changes[name].extend([self._passed] * 2)
        self._states = states

    def alternating(self, time: float) -> dict[str, float]:
        """
        Return what has changed its state more than twice a second over the last 5 s.

        Parameters
        ----------
        time
            Now [s].

        Returns
        -------
        dict
            Changes per second by name.

        """
        passed = self._passed + max(time - self._time, 0.0)
        recent = {name: sum(passed - change <= ALTERNATION_TIME for change in changes)
                  for name, changes in self._changes.items()}
        return {name: count / ALTERNATION_TIME for name, count in recent.items()
                if count > FASTEST_ALTERNATION * ALTERNATION_TIME}
