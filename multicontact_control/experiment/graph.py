"""
Running the ROS 2 graph: plain processes, started in order, watched, and stopped together.

The controller and the estimator are configured and activated from here; the others have nothing
to configure. The end of the simulator ends the run. The others are then stopped from the source
downwards, the recorder last, so that every message that was sent is in the bag when it closes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import contextlib
from dataclasses import dataclass
from pathlib import Path
import signal
import threading
import time
from types import FrameType
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.experiment.domain import reserve_domain
from multicontact_control.experiment.graph_spec import GraphSpec, MANAGED, SIM
from multicontact_control.experiment.lifecycle import (
    ACTIVATE,
    CONFIGURE,
    LifecycleDriver,
    TransitionError,
)
from multicontact_control.experiment.node_processes import NodeProcesses
from multicontact_control.experiment.progress import GraphProgress, ProgressListener

WATCH_PERIOD = 0.05
PROGRESS_PERIOD = 0.2


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

    """

    bag: Path
    timing: Mapping[str, Mapping[str, Any]]
    domain_id: int
    interrupted: int | None


def run_graph(
    spec: GraphSpec, on_progress: Callable[[GraphProgress], None] | None = None,
    on_domain: Callable[[int], None] = lambda domain_id: None,
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

    Returns
    -------
    GraphResult
        Where everything is.

    Raises
    ------
    RunError
        If a node cannot be started or dies: its name, how it ended and the end of its log.

    """
    spec.logs.mkdir(parents=True, exist_ok=True)
    with reserve_domain(spec.domain_id) as domain_id, collected_signals() as interrupted:
        on_domain(domain_id)
        processes = NodeProcesses(spec, domain_id)
        listener = ProgressListener(domain_id, spec.namespace) if (
            on_progress is not None) else None
        try:
            processes.start_all()
            bring_up(processes, interrupted, domain_id, spec.namespace)
            _watch(processes, interrupted, listener, on_progress)
        finally:
            if listener is not None:
                listener.close()
            processes.stop()
        if not interrupted:
            processes.raise_if_failed()
        return GraphResult(
            bag=spec.bag, timing=processes.timing(), domain_id=domain_id,
            interrupted=interrupted[0] if interrupted else None)


class _InterruptedError(Exception):
    """A signal came before the graph was up."""


def bring_up(
    processes: NodeProcesses, interrupted: list[int], domain_id: int, namespace: str,
) -> None:
    """Configure and activate the managed nodes."""
    def keep_waiting() -> None:
        processes.raise_if_failed()
        processes.raise_if_gone()
        if interrupted:
            raise _InterruptedError

    with contextlib.suppress(_InterruptedError), LifecycleDriver(
            domain_id, keep_waiting, namespace) as driver:
        for transition in (CONFIGURE, ACTIVATE):
            for name in MANAGED:
                try:
                    driver.change(name, transition)
                except TransitionError:
                    raise RunError(
                        processes.obituary(name, f'cannot {transition}')) from None


def _watch(
    processes: NodeProcesses, interrupted: list[int], listener: ProgressListener | None,
    on_progress: Callable[[GraphProgress], None] | None,
) -> None:
    """Wait until the simulator has ended or a signal has come."""
    next_progress = 0.0
    while not interrupted:
        processes.raise_if_failed()
        processes.raise_if_gone()
        if processes.ended(SIM):
            return
        if listener is not None and on_progress is not None and (
                time.monotonic() >= next_progress):
            next_progress = time.monotonic() + PROGRESS_PERIOD
            progress = listener.newest()
            if progress is not None:
                on_progress(progress)
        time.sleep(WATCH_PERIOD)


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
