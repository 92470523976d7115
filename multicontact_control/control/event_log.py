"""What a supervisor did in a run, and when."""

from __future__ import annotations

from multicontact_control.control.supervisor_status import SupervisorStatus

CAPACITY = 1000  # a limit that comes and goes at every tick must not fill the memory


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
