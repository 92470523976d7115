"""
Running the ROS 2 graph: plain processes, started in order, watched, and stopped together.

The controller and the estimator are configured and activated from here; the others have nothing
to configure. There is one time limit for the start, kept here: no node has one of its own. The
end of the simulator ends the run. The others are then stopped from the source downwards, the
recorder last, so that every message that was sent is in the bag when it closes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
import signal
import threading
import time
from types import FrameType
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.processes import NodeProcesses
from multicontact_control.experiment.graph.progress import GraphProgress, ProgressListener
from multicontact_control.experiment.graph.spec import COMPOSED, GraphSpec, MANAGED, SIM
from multicontact_control.nodes.link import (
    ACTIVATE,
    CONFIGURE,
    LifecycleDriver,
    TransitionError,
)

__all__ = ['COMPOSED', 'GraphResult', 'GraphSpec', 'run_graph']

WATCH_PERIOD = 0.05
PROGRESS_PERIOD = 0.2
START_BUDGET = 300.0  # s, until the first sample is answered
TELL_PERIOD = 5.0  # s, between two lines on what is waited for
SAMPLES = 'the first answered sample'

Tell = Callable[[str], None]


@dataclass(frozen=True)
class GraphResult:
    """
    How a run ended that no node failed in.

    Attributes
    ----------
    bag
        Folder of the recording, closed.
    timing
        Counts and times that each node wrote at its end, by node name.
    domain_id
        ROS domain it ran in.
    interrupted
        Signal that ended it early, None if it ran to its end.
    ended
        What ended it early on the side of a robot that is not this package's; empty if nothing.
    controlled
        Whether any sample was answered.

    """

    bag: Path
    timing: Mapping[str, Mapping[str, Any]]
    domain_id: int
    interrupted: int | None
    ended: str = ''
    controlled: bool = True


def run_graph(
    spec: GraphSpec, on_progress: Callable[[GraphProgress], None] = lambda progress: None,
    on_domain: Callable[[int], None] = lambda domain_id: None,
    on_wait: Tell = lambda text: None,
) -> GraphResult:
    """
    Run the graph to its end.

    SIGINT and SIGTERM end it early and cleanly; call it in the main thread for that.

    Parameters
    ----------
    spec
        What to run.
    on_progress
        Called about 5 times a second once samples flow.
    on_domain
        Called with the ROS domain that was chosen, before anything runs in it.
    on_wait
        Called every few seconds of a long start with what is waited for.

    Returns
    -------
    GraphResult
        Where everything is.

    Raises
    ------
    RunError
        If a node cannot be started or dies: the name of the first one that did, how it ended and
        the end of its log; or if the graph is not up within `START_BUDGET`.

    """
    spec.logs.mkdir(parents=True, exist_ok=True)
    with reserve_domain(spec.domain_id) as domain_id, collected_signals() as interrupted:
        on_domain(domain_id)
        processes = NodeProcesses(spec, domain_id)
        supervision = StartSupervision(processes, interrupted, on_wait)
        with ProgressListener(domain_id, spec.namespace) as listener:
            failed = True
            try:
                processes.start_all()
                bring_up(processes, supervision, domain_id, spec.namespace)
                _watch(processes, supervision, listener, on_progress)
                failed = False
            except InterruptedRunError:
                failed = False
            finally:
                processes.stop(abort=failed)
        if not interrupted:
            processes.raise_if_ended(at_its_end=True)
        return GraphResult(
            bag=spec.bag, timing=processes.timing(), domain_id=domain_id,
            interrupted=interrupted[0] if interrupted else None)


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

    """

    def __init__(self, processes: NodeProcesses, interrupted: list[int], tell: Tell) -> None:
        self._processes, self._interrupted, self._tell = processes, interrupted, tell
        self._start = time.monotonic()
        self._next = self._start + TELL_PERIOD

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
        now = time.monotonic()
        if now > self._start + START_BUDGET:
            raise RunError(f'the graph was not up after {START_BUDGET:g} s, still waiting for '
                           f'{self.describe(what)}')
        if now > self._next:
            self._next = now + TELL_PERIOD
            self._tell(f'{now - self._start:.0f} s: waiting for {self.describe(what)}')

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
    with LifecycleDriver(domain_id, supervision.wait, namespace) as driver:
        for transition in transitions:
            for name in MANAGED:
                try:
                    driver.change(name, transition)
                except TransitionError:
                    raise RunError(
                        processes.report(name, f'cannot {transition}')) from None


def _watch(
    processes: NodeProcesses, supervision: StartSupervision, listener: ProgressListener,
    on_progress: Callable[[GraphProgress], None],
) -> None:
    """Wait for the first sample, then until the simulator has ended or a signal has come."""
    next_progress = 0.0
    check = partial(supervision.wait, SAMPLES)
    while not processes.ended(SIM):
        check()
        if time.monotonic() >= next_progress:
            next_progress = time.monotonic() + PROGRESS_PERIOD
            progress = listener.newest()
            if progress is not None:
                check = partial(supervision.check)
                on_progress(progress)
        time.sleep(WATCH_PERIOD)
    supervision.check()


@contextlib.contextmanager
def collected_signals() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM in a list instead of dying of them."""
    received: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(number)

    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    previous = {x: signal.signal(x, note) for x in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
