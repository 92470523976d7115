"""Carries out what is asked for on a page, one after the other, and says what came of it."""

from __future__ import annotations

from collections.abc import Callable
import threading
import time
from typing import Any, NamedTuple

from multicontact_control.errors import MulticontactError
from multicontact_control.view.source import Source

END_TIMEOUT = 2.0  # s


class Outcome(NamedTuple):
    """What came of a command: whether it was obeyed, and in words."""

    obeyed: bool
    text: str


class Commander:
    """
    Gives commands to a source in a thread of its own, so that no element of a page waits for one.

    Of several that are asked for by the same element before the first is given, the last is.

    Parameters
    ----------
    source
        That obeys them, or refuses.
    on_outcome
        Called from that thread.

    """

    def __init__(self, source: Source, on_outcome: Callable[[Outcome], None]) -> None:
        self._source, self._on_outcome = source, on_outcome
        self._waiting: dict[object, tuple[str, dict[str, Any]]] = {}
        self._changed = threading.Condition()
        self._busy = self._over = False
        self._last = 0.0
        self._thread = threading.Thread(target=self._work, daemon=True, name='commander')
        self._thread.start()

    def give(self, element: object | None, name: str, /, **values: Any) -> None:
        """
        Give a command as soon as those before it have been given.

        Parameters
        ----------
        element
            Which asks; None for one of which every command counts.
        name, values
            The command.

        """
        with self._changed:
            # The elements of viser cannot be hashed, and live as long as the page.
            self._waiting[object() if element is None else id(element)] = name, values
            self._last = time.monotonic()
            self._changed.notify()

    def quiet_for(self) -> float:
        """Return for how long nothing has been asked for [s]; 0 while something is on its way."""
        with self._changed:
            return 0.0 if self._busy or self._waiting else time.monotonic() - self._last

    def close(self) -> None:
        """Give no more."""
        with self._changed:
            self._over = True
            self._changed.notify()
        self._thread.join(END_TIMEOUT)

    def _work(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.wait_for(lambda: self._waiting or self._over)
                if self._over:
                    return
                element = next(iter(self._waiting))
                name, values = self._waiting.pop(element)
                self._busy = True
            try:
                outcome = Outcome(True, self._source.command(name, **values))
            except MulticontactError as error:
                outcome = Outcome(False, str(error))
            self._on_outcome(outcome)
