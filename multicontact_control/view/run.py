"""The life of a page: find or start what it shows, serve it, end what was started."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
import webbrowser

from multicontact_control.errors import ConfigError
from multicontact_control.judging.run_folders import CONFIG_FOLDER
from multicontact_control.runs.compilation import ensure_compiled
from multicontact_control.runs.scenario import Setup
from multicontact_control.view.source import SnapshotSource


@dataclass(frozen=True)
class ViewSubject:
    """
    What a page shows: a recording, a graph that runs, or else a simulated graph that it starts.

    Attributes
    ----------
    setup
        The arm, its contacts and its plant; of a recording or a graph, what is known of them.
    recording
        Folder of a run or bag that is replayed.
    graph
        Whether the page joins a graph that runs.
    namespace, domain_id
        Where the graph runs, or is started.

    """

    setup: Setup
    recording: Path | None = None
    graph: bool = False
    namespace: str | None = None
    domain_id: int | None = None


def run_view(
    subject: ViewSubject,
    tell: Callable[[str], object],
    *,
    port: int = 8080,
    open_browser: bool = False,
) -> str:
    """
    Show a graph or a recording on a page until a signal comes, e.g. by Ctrl-C.

    A simulated graph that it starts ends with the page.

    Parameters
    ----------
    subject
        What the page shows.
    tell
        Called with each line for the user.
    port
        TCP port of the page on this machine; the next one that is free if it is taken.
    open_browser
        Whether the page is opened in the browser of the user.

    Returns
    -------
    str
        Why the graph has ended by itself; empty if the user has ended the page.

    Raises
    ------
    MulticontactError
        If viser is missing, or if graph or recording cannot be shown.

    """
    if subject.graph and subject.recording is not None:
        raise ConfigError('--graph', hint='leave it out with a recording')
    try:
        from multicontact_control.view.page import Page
    except ImportError as error:
        raise ConfigError(
            'view', 'viser, by pip install viser', f'none that can be loaded ({error})'
        ) from None
    from multicontact_control.runs.graph.run import (
        collected_signals,
        InterruptedRunError,
    )

    with (
        suppress(InterruptedRunError),
        collected_signals() as signals,
        ExitStack() as stack,
    ):
        shown = _open_source(subject, stack, signals, tell)
        stack.callback(shown.close)
        page = Page(shown, port)
        stack.callback(page.close)
        tell(f'{shown.scene.title}: {page.url}')
        tell('only this machine can reach it')
        if open_browser:
            webbrowser.open(page.url)
        page.run_until(lambda: bool(signals))
        return page.ended
    return ''


def _open_source(
    subject: ViewSubject,
    stack: ExitStack,
    signals: Sequence[int],
    tell: Callable[[str], object],
) -> SnapshotSource:
    """Open a recording, join a graph or start one; see `start_simulated_graph`."""
    if subject.recording is not None:
        from multicontact_control.view.replay import load_replay

        return load_replay(subject.recording, subject.setup, subject.namespace)
    if subject.graph:
        from multicontact_control.view.graph import GraphSource

        return GraphSource(
            subject.setup,
            namespace=subject.namespace or '',
            domain_id=subject.domain_id,
        )
    return start_simulated_graph(subject, stack, signals, tell)


def start_simulated_graph(
    subject: ViewSubject,
    stack: ExitStack,
    signals: Sequence[int],
    tell: Callable[[str], object],
) -> SnapshotSource:
    """
    Start a simulated graph that obeys commands and records nothing; return a source that joins it.

    Parameters
    ----------
    subject
        The setup whose parameter files the nodes read, and where the graph runs; without a domain,
        the first one that is free on this machine.
    stack
        Ends the nodes and removes their folder when it is closed.
    signals
        Signals that have come so far; one of them ends the wait for the nodes.
    tell
        Called with each line for the user.

    Raises
    ------
    MulticontactError
        If the nodes do not come up.
    InterruptedRunError
        If a signal comes before they are up.

    """
    from multicontact_control.judging.judged_run import simulation_parameters
    from multicontact_control.runs.graph.domain import check_namespace
    from multicontact_control.runs.graph.run import (
        InterruptedRunError,
        running_graph,
    )
    from multicontact_control.runs.graph.spec import GraphSpec
    from multicontact_control.view.graph import GraphSource

    def stop_waiting_on_signal(_: str) -> None:
        if signals:
            raise InterruptedRunError

    setup = subject.setup
    namespace = check_namespace(subject.namespace or '')
    ensure_compiled()
    tell('starting the nodes')
    folder = Path(stack.enter_context(TemporaryDirectory(prefix='multicontact-view-')))
    spec = GraphSpec(
        out=folder,
        ticks=0,
        rate=setup.controller.rate,
        seed=setup.seed,
        recorded=False,
        domain_id=subject.domain_id,
        namespace=namespace,
        parameter_files=setup.write(folder / CONFIG_FOLDER),
        extra_parameters=simulation_parameters(setup),
    )
    graph = stack.enter_context(running_graph(spec, stop_waiting_on_signal))
    return GraphSource(
        setup,
        f'{setup.plant_name}, simulated in ROS domain {graph.domain_id}',
        namespace=namespace,
        domain_id=graph.domain_id,
        check=graph.processes.check_running,
    )
