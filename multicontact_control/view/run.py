"""From what is to be shown to a page that shows it, until it is ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
import webbrowser

from multicontact_control.errors import ConfigError
from multicontact_control.judging.run_folders import CONFIG_FOLDER
from multicontact_control.runs.compilation import ensure_compiled
from multicontact_control.runs.scenario import Setup
from multicontact_control.view.source import Source


def run_view(
    setup: Setup,
    tell: Callable[[str], object],
    *,
    recording: Path | None = None,
    graph: bool = False,
    namespace: str | None = None,
    domain_id: int | None = None,
    port: int = 8080,
    open_browser: bool = False,
) -> str:
    """
    Show a graph or a recording on a page until a signal comes; MulticontactError if it cannot be.

    It replays a `recording`, the folder of a run or bag; or joins the graph that runs; or starts
    one of `setup`, and ends it. Otherwise `setup` is what is known of graph or recording.
    `namespace` and `domain_id` are where the graph is, or is to be; `tell` is called with lines
    for the user. The page listens on `port`, or the next one that is free. Returns why there was
    nothing more to see, empty if the user has ended it.
    """
    if graph and recording is not None:
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
        shown: Source
        if recording is not None:
            from multicontact_control.view.replay import load_replay

            shown = load_replay(recording, setup, namespace)
        elif graph:
            from multicontact_control.view.graph import GraphSource

            shown = GraphSource(setup, namespace=namespace or '', domain_id=domain_id)
        else:
            shown = started(setup, namespace, domain_id, stack, signals, tell)
        stack.callback(shown.close)
        page = Page(shown, port)
        stack.callback(page.close)
        tell(f'{shown.scene.title}: {page.url}')
        tell('only this machine can reach it')
        if open_browser:
            webbrowser.open(page.url)
        page.run(lambda: bool(signals))
        return page.ended
    return ''


def started(
    setup: Setup,
    namespace: str | None,
    domain_id: int | None,
    stack: ExitStack,
    signals: Sequence[int],
    tell: Callable[[str], object],
) -> Source:
    """Start a graph that obeys commands, without a recorder, and return what joins it."""
    from multicontact_control.judging.judged_run import simulation_parameters
    from multicontact_control.runs.graph.domain import check_namespace
    from multicontact_control.runs.graph.run import (
        InterruptedRunError,
        running_graph,
    )
    from multicontact_control.runs.graph.spec import GraphSpec
    from multicontact_control.view.graph import GraphSource

    def keep_waiting(_: str) -> None:
        if signals:
            raise InterruptedRunError

    namespace = check_namespace(namespace or '')
    ensure_compiled()
    tell('starting the nodes')
    folder = Path(stack.enter_context(TemporaryDirectory(prefix='multicontact-view-')))
    graph = stack.enter_context(
        running_graph(
            GraphSpec(
                out=folder,
                ticks=0,
                rate=setup.controller.rate,
                seed=setup.seed,
                recorded=False,
                domain_id=domain_id,
                namespace=namespace,
                parameter_files=setup.write(folder / CONFIG_FOLDER),
                extra_parameters=simulation_parameters(setup),
            ),
            keep_waiting,
        )
    )
    return GraphSource(
        setup,
        f'{setup.plant_name}, simulated in ROS domain {graph.domain_id}',
        namespace=namespace,
        domain_id=graph.domain_id,
        check=graph.processes.check_running,
    )
