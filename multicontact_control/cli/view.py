"""`multicontact view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line, EXIT_FAILED
from multicontact_control.cli.options import (
    DomainId,
    Engine,
    given_options,
    Namespace,
    Plant,
    Preset,
    refuse_options,
    resolve_settings,
    Robot,
    Scenario,
    Seed,
    Settings,
)
import typer

# What says which arm it is; a run knows that, other recordings do not.
OF_THE_ARM = ('scenario', 'robot', 'plant', 'preset', 'settings')


def view(
    context: typer.Context,
    recording: Annotated[Path | None, typer.Argument(
        metavar='[RUN]', help='Folder of `run` or `simulate`, or a bag, to replay.')] = None,
    graph: Annotated[bool, typer.Option(
        '--graph', help='Join the ROS 2 graph that runs, instead of simulating.')] = False,
    namespace: Namespace = None,
    domain_id: DomainId = None,
    scenario: Scenario = 'paper', robot: Robot = '', plant: Plant = '', seed: Seed = 0,
    preset: Preset = 'best', settings: Settings = None, engine: Engine = '',
    host: Annotated[str, typer.Option(
        help='Address to listen on; any other than that of this machine needs a token.')] = '',
    port: Annotated[int, typer.Option(
        help='Port, or the next one that is free.', min=1, max=65535)] = 8080,
    token: Annotated[str, typer.Option(
        help='Token to ask for; made up where others can reach the page.')] = '',
    open_browser: Annotated[bool, typer.Option('--open', help='Open the browser.')] = False,
    screenshot: Annotated[Path | None, typer.Option(
        metavar='FILE', help='Press with 10 N on every contact of the simulation, take a picture '
        'of the page with Chromium, and end.')] = None,
    size: Annotated[str, typer.Option(
        metavar='WIDTHxHEIGHT', help='Of that picture [px].')] = '1600x900',
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

            given = given_options(context)
            refuse_options(given, ('seed', 'engine'), 'a recording')
            if run_of(recording)[1]:
                refuse_options(given, OF_THE_ARM, 'a run, which knows its own')
        setup = resolve_settings(
            scenario, {'plant': plant, 'robot': robot, 'seed': seed, 'preset': preset,
                       'plant_overrides': {'engine': engine} if engine else None}, settings)
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.view.installed import require_viser

        require_viser()
        from multicontact_control.view.run import read_size, run_view, ViewOptions

        ended = run_view(setup, ViewOptions(
            recording=recording, graph=graph, namespace=namespace, domain_id=domain_id, host=host,
            port=port, token=token, open_browser=open_browser, screenshot=screenshot,
            size=read_size(size)),
            say=typer.echo)
    if ended:
        typer.echo(f'multicontact: {ended}', err=True)
        raise typer.Exit(EXIT_FAILED)
