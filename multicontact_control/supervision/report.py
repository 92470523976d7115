"""What a supervisor reports: of every tick, and of a whole run."""

from __future__ import annotations

from collections import Counter, deque
from typing import Any, NamedTuple

from multicontact_control.control.controller import ControlOutput
from multicontact_control.records import CONTACT, CONTROL
from multicontact_control.supervision.checks import COLLISION
import numpy as np

EVENT_CAPACITY = (
    1000  # events; a limit that comes and goes at every tick must not fill the memory
)


class SupervisorStatus(NamedTuple):
    """What the supervisor did in a tick, and why; the same object as long as nothing changes."""

    reaction: (
        str  # ``none``, ``inflate`` (R), or ``hold``, ``float``, ``damp`` for the law
    )
    causes: tuple[str, ...] = ()  # what called for it
    rejected: tuple[
        str, ...
    ] = ()  # what was wrong with readings, whether it called for it or not
    limits: tuple[str, ...] = ()  # that were enforced
    contact_states: tuple[str, ...] = ()
    unwatched: str = (
        ''  # whose measured torques are of no use, and what is not watched therefore
    )
    read_before: tuple[
        str, ...
    ] = ()  # what was read of contacts before a touch, in words


def make_empty_answer(joints: int, contacts: int) -> ControlOutput:
    """Return the answer before anything is known."""
    controls = np.zeros(1, dtype=CONTROL)
    controls['frame']['rotation'] = controls['task']['rotation'] = np.eye(3)
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
        Ticks whose status was that of the tick before, since the last `note`.
    collisions
        Beginnings of them, by cause.

    """

    def __init__(self) -> None:
        self.events: deque[tuple[float, str]] = deque(maxlen=EVENT_CAPACITY)
        self.collisions: Counter[str] = Counter()
        self.repeats = 0
        self._status: SupervisorStatus | None = None  # of the newest tick
        self._ticks: dict[str, Counter[str]] = {
            name: Counter() for name in ('reaction', 'rejected', 'limits')
        }
        self._before: tuple[Any, ...] = ('', ())

    @property
    def reaction_counts(self) -> Counter[str]:
        """Return in how many ticks there was each reaction."""
        return self._counted()['reaction']

    @property
    def rejected_counts(self) -> Counter[str]:
        """Return in how many ticks a reading was not used, by what was wrong with it."""
        return self._counted()['rejected']

    @property
    def limit_counts(self) -> Counter[str]:
        """Return in how many ticks each limit was enforced."""
        return self._counted()['limits']

    def _counted(self) -> dict[str, Counter[str]]:
        """Count the ticks of the newest status."""
        status, ticks = self._status, self.repeats
        self.repeats = 0
        if status is not None and ticks > 0:
            self._ticks['reaction'][status.reaction] += ticks
            for name, found in (
                ('rejected', status.rejected),
                ('limits', status.limits),
            ):
                for each in found:
                    self._ticks[name][each] += ticks
        return self._ticks

    def note_status(self, time: float, status: SupervisorStatus) -> None:
        """Take in the status of a tick that is not as the one before, at a time [s]."""
        self._counted()
        self._status, self.repeats = status, 1
        now = (
            status.reaction,
            status.causes,
            status.limits,
            status.contact_states,
            len(status.read_before),
        )
        if now == self._before:
            return
        for cause in status.causes:
            if cause.startswith(COLLISION) and cause not in self._before[1]:
                self.collisions[cause] += 1
        self._before = now
        self.events.append(
            (
                time,
                ' | '.join(
                    [
                        status.reaction,
                        ' '.join(status.causes + status.limits),
                        ', '.join(status.contact_states),
                        *status.read_before,
                    ]
                ),
            )
        )
