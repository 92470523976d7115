"""
Running the ROS 2 graph: plain processes, started in order, watched, and stopped together.

The controller and the estimator are configured and activated from here; the others have nothing
to configure. There is one time limit for the start, kept here: no node has one of its own. The
end of the simulator ends the run. The others are then stopped from the source downwards, the
recorder last, so that every message that was sent is in the bag when it closes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.processes import NodeEndedError, NodeProcesses
from multicontact_control.experiment.graph.progress import GraphProgress, ProgressListener
from multicontact_control.experiment.graph.spec import GraphSpec, SIM
from multicontact_control.experiment.graph.watching import (
    bring_up,
    collected_signals,
    InterruptedRunError,
    SAMPLES,
    StartSupervision,
    Tell,
    watch,
)


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

    SIGINT, SIGTERM and SIGHUP end it early and cleanly; call it in the main thread for that.

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
                watch(listener, on_progress, partial(_end, processes, supervision))
                supervision.check()
                failed = False
            except InterruptedRunError:
                failed = False
            except NodeEndedError as error:
                if error.node_name == SIM and error.code > 0 and listener.heard:
                    raise RunError(f'{listener.waited_for()} does not answer; {error}') from None
                raise
            finally:
                processes.stop(abort=failed)
            listener.newest()
            controlled = listener.heard or not interrupted
        if controlled:  # one that is interrupted while it starts ends as it may
            processes.raise_if_failed()
        return GraphResult(
            bag=spec.bag, timing=processes.timing(), domain_id=domain_id,
            interrupted=interrupted[0] if interrupted else None, controlled=controlled)


def _end(
    processes: NodeProcesses, supervision: StartSupervision, progress: GraphProgress | None,
) -> str | None:
    """Return '' when the simulator has ended; wait for the first sample until then."""
    if processes.ended(SIM):
        return ''
    if progress is None:
        supervision.wait(SAMPLES)
    else:
        supervision.check()
    return None
