"""The supervisor's log as it is read on a page: what has changed, in words."""

from __future__ import annotations

from collections.abc import Sequence

from multicontact_control.experiment.judge import read_event

NONE = 'none'


class EventReader:
    """
    Reads lines of the log, one after the other.

    Parameters
    ----------
    contact_names
        In the order of the states in them.

    """

    def __init__(self, contact_names: Sequence[str]) -> None:
        self._names = tuple(contact_names)
        self._reaction: str = NONE
        self._states: tuple[str, ...] = ()
        self._limits: tuple[str, ...] = ()

    def read(self, what: str) -> str:
        """Return what has changed, nothing if that is nothing; other texts as they are."""
        if what.count(' | ') != 2:
            return what
        event = read_event(0.0, what)
        parts = []
        if event.reaction != self._reaction:
            causes = f' ({" ".join(event.causes)})' if event.causes else ''
            parts.append(event.reaction + causes if event.reaction != NONE else 'control again')
        parts += [f'{name} {state}' for name, state, before in zip(
            self._names, event.contact_states, self._states or ('free',) * len(self._names))
            if state != before]
        new = [limit for limit in event.limits if limit not in self._limits]
        if new:
            parts.append(f'limit: {" ".join(new)}')
        self._reaction, self._limits = event.reaction, event.limits
        self._states = event.contact_states
        return ', '.join(parts)
