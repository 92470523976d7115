"""`multicontact run`, `simulate`, `view` and `demo`."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, TYPE_CHECKING

from multicontact_control.cli import options
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.runs.graph.node_process import prepare_nodes
import typer

if TYPE_CHECKING:
    from multicontact_control.runs.scenario import Setup

OF_THE_PLANT = (
    'robot',
    'plant',
    'seed',
    'commanded',
    'speed',
    'free_running',
    'engine',
)
# A run knows its arm, other recordings do not.
OF_THE_ARM = ('scenario', 'robot', 'plant', 'preset', 'settings')


@dataclass(frozen=True)
class GraphOptions:
    """Options of `run`: what is behind the topics, and how time passes."""

    commanded: Annotated[
        bool,
        typer.Option(
            '--commanded',
            help='The simulated arm obeys the command topics instead of a scenario. '
            'Ends after --duration, or with Ctrl-C.',
        ),
    ] = False
    speed: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=100.0,
            help='Largest real-time factor; 0 for as fast as it goes. The torques '
            'are those of `simulate`, bit for bit, at any speed.',
        ),
    ] = 1.0
    free_running: Annotated[
        bool,
        typer.Option(
            '--free-running',
            help='The simulated arm does not wait for commands, as a robot does; '
            'missed deadlines are counted.',
        ),
    ] = False
    external: Annotated[
        bool,
        typer.Option(
            '--external',
            help='Your own robot or simulator is behind the topics; the controller '
            'obeys the command topics, or a --scenario. Needs --controller.',
        ),
    ] = False
    controller: options.ControllerFiles = None
    realtime: Annotated[
        bool,
        typer.Option(
            '--realtime',
            help='Ask for SCHED_FIFO and locked memory for the controlling nodes, which '
            'warn of what is not granted.',
        ),
    ] = False


@options.flatten_options
def run(
    context: typer.Context,
    chosen: options.RunOptions,
    graph: GraphOptions,
    place: options.PlaceOptions,
) -> None:
    """
    Run a scenario on the ROS 2 graph, and record it.

    Starts simulator, controller, noise estimator and recorder, each in a process of its own. At
    its end, or at Ctrl-C, the recording is judged and drawn; a second Ctrl-C skips that. The
    simulator waits for the controller: a busy machine makes simulated time slow, and the forces
    stay the same. Exit code 0: stable, poor or not judged; 1: not stable, held by the supervisor,
    a node died, or the external robot is gone.
    """
    from multicontact_control.runs.graph.domain import check_namespace

    namespace = check_namespace(place.namespace or '')
    options.end_at_signals('interrupted')
    # The nodes' modules are loaded by another process, while this one loads its own.
    prepare_nodes()
    if graph.external:
        options.refuse_options(context, OF_THE_PLANT, 'with --external')
        setup = chosen.external(graph.controller or (), context)
    else:
        options.refuse_options(context, ['controller'], 'without --external')
        options.tell_missing_engine()
        setup = _simulated_setup(chosen, commanded=graph.commanded)
    # Only now: bad input is refused before the simulator is loaded.
    from multicontact_control.judging.judged_run import run_on_graph

    with _results_folder(chosen, setup) as folder:
        summary, interrupted = run_on_graph(
            setup,
            folder,
            supervised=not chosen.bare,
            free_running=graph.free_running,
            speed=graph.speed,
            domain_id=place.domain_id,
            namespace=namespace,
            realtime=graph.realtime,
        )
    if interrupted is not None:
        raise typer.Exit(options.EXIT_SIGNAL + interrupted)
    end_by_verdict(summary)


def _simulated_setup(chosen: options.RunOptions, *, commanded: bool) -> Setup:
    """Return the setup of a simulated arm, which obeys commands or plays its scenario."""
    if not commanded:
        return chosen.setup(nodes=True)
    for setting in chosen.settings or ():
        if setting.startswith('scenario.'):
            raise ConfigError(
                '--set scenario',
                hint='leave it out with --commanded, which plays '
                'no scenario; --duration sets the length',
            )
    setup = chosen.setup(nodes=True)
    if chosen.duration is None:
        return setup.commanded_over_topics()
    return setup.commanded_over_topics(chosen.duration)


def _results_folder(
    chosen: options.RunOptions, setup: Setup
) -> AbstractContextManager[Path]:
    from multicontact_control.judging.run_folders import open_run_folder

    return open_run_folder(
        chosen.out, setup.scenario.name, overwrite=chosen.overwrite, now=datetime.now()
    )


@options.flatten_options
def simulate(chosen: options.RunOptions) -> None:
    """
    Run a scenario in one process, without ROS, as fast as it goes.

    The same seed gives the same run, bit for bit; Ctrl-C discards it. Exit code 0: stable, poor or
    not judged; 1: not stable, or held by the supervisor.
    """
    options.end_at_signals('interrupted; nothing of this run is kept')
    options.tell_missing_engine()
    setup = chosen.setup()
    from multicontact_control.judging.judged_run import simulate_run

    with _results_folder(chosen, setup) as folder:
        summary = simulate_run(setup, folder, supervised=not chosen.bare)
    end_by_verdict(summary)


def end_by_verdict(summary: dict[str, Any] | None) -> None:
    """
    Exit with 1 if there is no run, or it was judged and its loop is not known to be stable.

    `summary` is that of the run's folder; None of a run that no report was made of.
    """
    if summary is None or not (summary['stable'] or summary['unjudged']):
        raise typer.Exit(options.EXIT_FAILED)


@dataclass(frozen=True)
class PageOptions:
    """Options of `view`: what the page shows, and where it is."""

    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar='RUN', help='Folder of `run` or `simulate`, or a bag, to replay.'
        ),
    ] = None
    graph: Annotated[
        bool,
        typer.Option(
            '--graph', help='Join the ROS 2 graph that runs, instead of starting one.'
        ),
    ] = False
    port: Annotated[
        int, typer.Option(help='Port, or the next one that is free.', min=1, max=65535)
    ] = 8080
    open_browser: Annotated[bool, typer.Option('--open', help='Open the browser.')] = (
        False
    )


@options.flatten_options
def view(
    context: typer.Context,
    chosen: options.SetupOptions,
    page: PageOptions,
    place: options.PlaceOptions,
) -> None:
    """
    See and steer the arm and its contact forces in the browser.

    Without --graph or a recording it starts a graph as `run --commanded` does, but does not record
    it: simulator, controller and noise estimator, in --domain-id or a domain that is free. Ctrl-C
    ends the page and that graph. Exit code 1: what was shown has ended by itself; 2: bad input, or
    viser is not installed.
    """
    recording = page.recording
    if recording is not None:
        from multicontact_control.judging.run_folders import (
            find_run_folder,
            is_run_folder,
        )

        options.refuse_options(context, ('seed', 'engine'), 'with a recording')
        if is_run_folder(find_run_folder(recording)):
            options.refuse_options(
                context, OF_THE_ARM, 'with a run, which knows its own'
            )
    starts_graph = not page.graph and recording is None
    if starts_graph:
        options.tell_missing_engine()
    setup = chosen.setup(nodes=starts_graph)
    _show(setup, page, place)


@options.flatten_options
def demo(chosen: options.SetupOptions) -> None:
    """
    Open a page in the browser: press, slide and push a simulated arm.

    As `view --open`, which also replays recordings and joins graphs that run. Ctrl-C ends it.
    """
    options.tell_missing_engine()
    _show(
        chosen.setup(nodes=True), PageOptions(open_browser=True), options.PlaceOptions()
    )


def _show(setup: Setup, page: PageOptions, place: options.PlaceOptions) -> None:
    """Show a page until Ctrl-C; RunError if what is shown has ended by itself."""
    # Only now: bad input is refused before viser is loaded.
    from multicontact_control.view.run import run_view, ViewSubject

    subject = ViewSubject(setup, page.recording, page.graph, **vars(place))
    ended = run_view(
        subject, typer.echo, port=page.port, open_browser=page.open_browser
    )
    if ended:
        raise RunError(ended)
