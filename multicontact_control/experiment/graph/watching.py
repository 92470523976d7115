"""What is done while a graph is waited for: its nodes, signals and the time are looked at."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
import os
import signal
import stat
import threading
import time
from types import FrameType

from multicontact_control.errors import RunError
from multicontact_control.experiment.graph.processes import NodeProcesses
from multicontact_control.experiment.graph.progress import GraphProgress, ProgressListener
from multicontact_control.experiment.graph.spec import MANAGED
from multicontact_control.nodes.link import (
    ACTIVATE,
    CONFIGURE,
    GuestNode,
    TransitionError,
)

WATCH_PERIOD = 0.05
PROGRESS_PERIOD = 0.2
START_BUDGET = 300.0  # s, until the first sample is answered
TELL_PERIOD = 5.0  # s, between two lines on what is waited for
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SAMPLES = 'the first answered sample'

Tell = Callable[[str], None]


class InterruptedRunError(Exception):
    """A signal came."""


class StartSupervision:
    """
    What is looked at while something is waited for: nodes that end, signals, the time.

    Parameters
    ----------
    processes
        The nodes.
    interrupted
        Signals that have come.
    tell
        Called every few seconds with what is waited for, and what that node does.
    first_tell
        When it is called first [s]; `TELL_PERIOD` if not given.

    """

    def __init__(
        self, processes: NodeProcesses, interrupted: list[int], tell: Tell,
        first_tell: float | None = None,
    ) -> None:
        self._processes, self._interrupted, self._tell = processes, interrupted, tell
        self._start = time.monotonic()
        self._next = self._start + (TELL_PERIOD if first_tell is None else first_tell)

    def check(self) -> None:
        """
        Raise if there is no point in going on.

        Raises
        ------
        NodeEndedError
            If a node has ended that should not have.
        InterruptedRunError
            If a signal has come.

        """
        if self._interrupted:
            raise InterruptedRunError
        self._processes.raise_if_ended(at_its_end=True)

    def wait(self, what: str) -> None:
        """
        Check, and keep the time of the start.

        Parameters
        ----------
        what
            What is waited for; begins with the name of a node, if it is for one.

        Raises
        ------
        RunError
            As `check`, and if the start takes more than `START_BUDGET`.

        """
        self.check()
        if time.monotonic() > self._start + START_BUDGET:
            raise RunError(f'the graph was not up after {START_BUDGET:g} s, still waiting for '
                           f'{self.describe(what)}')
        self.remind(lambda: self.describe(what))

    def remind(self, missing: Callable[[], str]) -> None:
        """Tell what is waited for, if that has not been told for a while."""
        now = time.monotonic()
        if now > self._next:
            self._next = now + TELL_PERIOD
            self._tell(f'{now - self._start:.0f} s: waiting for {missing()}')

    def describe(self, what: str) -> str:
        """Return what is waited for, with the last line of each node's log that is concerned."""
        names = [name for name in self._processes.names if what.startswith(name)]
        said = '; '.join(
            f'{name}: {self._processes.last_line(name) or "nothing said yet"}'
            for name in names or self._processes.names)
        return f'{what} ({said})'


def bring_up(
    processes: NodeProcesses, supervision: StartSupervision, domain_id: int, namespace: str,
    transitions: Sequence[str] = (CONFIGURE, ACTIVATE),
) -> None:
    """Configure and activate the managed nodes."""
    with GuestNode('lifecycle_driver', domain_id, namespace,
                   keep_waiting=supervision.wait) as driver:
        for transition in transitions:
            for name in MANAGED:
                try:
                    driver.change(name, transition)
                except TransitionError:
                    raise RunError(
                        processes.report(name, f'cannot {transition}')) from None


def watch(
    listener: ProgressListener, on_progress: Callable[[GraphProgress], None],
    ended: Callable[[GraphProgress | None], str | None],
) -> str:
    """
    Look at a graph until it has ended.

    Parameters
    ----------
    listener
        Hears of its progress.
    on_progress
        Called with that about 5 times a second, once there is any.
    ended
        Called with the newest progress, None before the first, about 20 times a second; returns
        what has ended the graph, None as long as nothing has.

    Returns
    -------
    str
        That.

    """
    newest: GraphProgress | None = None
    next_progress = 0.0
    while (end := ended(newest)) is None:
        if time.monotonic() >= next_progress:
            next_progress = time.monotonic() + PROGRESS_PERIOD
            progress = listener.newest()
            if progress is not None:
                newest = progress
                on_progress(progress)
        time.sleep(WATCH_PERIOD)
    return end


def _leave_terminal() -> None:
    """Print to files only from here on: a terminal that has hung up refuses output."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        if not stat.S_ISREG(os.fstat(number).st_mode):
            os.dup2(nowhere, number)
    os.close(nowhere)


@contextlib.contextmanager
def collected_signals() -> Iterator[list[int]]:
    """Collect signals that ask for an end in a list instead of dying of them."""
    received: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(number)
        if number == signal.SIGHUP:
            _leave_terminal()

    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    previous = {x: signal.signal(x, note) for x in ENDING
                if x != signal.SIGHUP or signal.getsignal(x) != signal.SIG_IGN}  # by nohup
    try:
        yield received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
