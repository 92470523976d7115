"""`multicontact view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli import options
import typer

# What says which arm it is; a run knows that, other recordings do not.
OF_THE_ARM = ('scenario', 'robot', 'plant', 'preset', 'settings')


def view(
    context: typer.Context, chosen: options.SetupOptions,
    recording: Annotated[Path | None, typer.Argument(
        metavar='RUN', help='Folder of `run` or `simulate`, or a bag, to replay.')] = None,
    graph: Annotated[bool, typer.Option(
        '--graph', help='Join the ROS 2 graph that runs, instead of starting one.')] = False,
    namespace: options.Namespace = None, domain_id: options.DomainId = None,
    port: Annotated[int, typer.Option(
        help='Port, or the next one that is free.', min=1, max=65535)] = 8080,
    open_browser: Annotated[bool, typer.Option('--open', help='Open the browser.')] = False,
) -> None:
    """
    See and steer the arm and its contact forces in the browser.

    Without --graph or a recording it starts a graph as `run --commanded` does, but does not record
    it: simulator, controller and noise estimator, in --domain-id or a domain that is free. Ctrl-C
    ends the page and that graph. Exit code 1: what was shown has ended by itself; 2: bad input, or
    viser is not installed.
    """
    if recording is not None:
        from multicontact_control.experiment.results import run_of

        options.refuse_options(context, ('seed', 'engine'), 'with a recording')
        if run_of(recording)[1]:
            options.refuse_options(context, OF_THE_ARM, 'with a run, which knows its own')
    setup = chosen.setup()
    # Only now: bad input is refused before viser is loaded.
    from multicontact_control.view.run import run_view

    ended = run_view(
        setup, typer.echo, recording=recording, graph=graph, namespace=namespace,
        domain_id=domain_id, port=port, open_browser=open_browser)
    if ended:
        typer.echo(f'multicontact: {ended}', err=True)
        raise typer.Exit(options.EXIT_FAILED)
