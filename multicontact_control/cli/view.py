"""`multicontact view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.cli.exits import errors_in_one_line, EXIT_FAILED
import typer

# What says which arm it is; a run knows that, other recordings do not.
OF_THE_ARM = ('scenario', 'robot', 'plant', 'preset', 'settings')


def view(
    context: typer.Context,
    recording: Annotated[Path | None, typer.Argument(
        metavar='[RUN]', help='Folder of `run` or `simulate`, or a bag, to replay.')] = None,
    graph: Annotated[bool, typer.Option(
        '--graph', help='Join the ROS 2 graph that runs, instead of simulating.')] = False,
    namespace: options.Namespace = None, domain_id: options.DomainId = None,
    scenario: options.Scenario = 'paper', robot: options.Robot = '', plant: options.Plant = '',
    seed: options.Seed = 0, preset: options.Preset = 'best', settings: options.Settings = None,
    engine: options.Engine = '',
    port: Annotated[int, typer.Option(
        help='Port, or the next one that is free.', min=1, max=65535)] = 8080,
    open_browser: Annotated[bool, typer.Option('--open', help='Open the browser.')] = False,
) -> None:
    """
    See the arm, its contacts and their forces in the browser, and steer it.

    Without a graph or a recording it simulates, in real time: contacts of --scenario, on --plant,
    but its reference is yours. Ctrl-C ends it. Exit code 1: what was shown has ended by itself;
    2: bad input, or what it needs is not installed.
    """
    with errors_in_one_line():
        if recording is not None:
            from multicontact_control.experiment.results import run_of

            given = options.given_options(context)
            options.refuse_options(given, ('seed', 'engine'), 'a recording')
            if run_of(recording)[1]:
                options.refuse_options(given, OF_THE_ARM, 'a run, which knows its own')
        setup = options.resolve_settings(
            scenario, {'plant': plant, 'robot': robot, 'seed': seed, 'preset': preset,
                       'plant_overrides': {'engine': engine} if engine else None}, settings)
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.view.run import run_view

        ended = run_view(
            setup, typer.echo, recording=recording, graph=graph, namespace=namespace,
            domain_id=domain_id, port=port, open_browser=open_browser)
    if ended:
        typer.echo(f'multicontact: {ended}', err=True)
        raise typer.Exit(EXIT_FAILED)
