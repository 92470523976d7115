"""`multicontact faults`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli.exits import (
    errors_in_one_line,
    EXIT_FAILED,
    EXIT_SIGNAL,
    require_ros,
    resumable,
)
from multicontact_control.errors import ConfigError
from rich.console import Console
import typer


def faults(
    seed: Annotated[int, typer.Option(help='Seed of the first fault of every kind.')] = 0,
    out: Annotated[Path, typer.Option(
        help='Folder for faults.json. Faults that are finished there are not run again.',
    )] = Path('runs/faults'),
    quick: Annotated[bool, typer.Option(
        '--quick', help='One fault of each kind instead of 14.')] = False,
    graph: Annotated[bool, typer.Option(
        '--graph', help='Also kill nodes, damage messages and send wrong commands in a running '
        'ROS 2 graph, in real time.')] = False,
    jobs: Annotated[int, typer.Option(help='Faults at once; 0 for every core.')] = 0,
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Run everything again.')] = False,
) -> None:
    """
    Break inputs and plant in many ways, and check that the arm stays safe.

    Exit code 0: every fault was safe; 1: one was not; 2: bad input; 128 + n: ended by signal n.
    """
    interrupted = None
    with resumable(), errors_in_one_line():
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.faults.campaign import (
            print_report,
            run_campaign,
            write_report,
        )

        if seed < 0:
            raise ConfigError('seed', 'a whole number >= 0', seed)
        rows = run_campaign(seed, out, quick=quick, jobs=jobs, overwrite=overwrite)
        if graph:
            require_ros()
            from multicontact_control.experiment.faults.in_graph import run_graph_campaign

            over_graph, interrupted = run_graph_campaign(seed, out, quick=quick)
            rows += over_graph
        path = write_report(out, rows)
    print_report(rows, Console())
    typer.echo(f'written to {path}')
    if interrupted is not None:
        raise typer.Exit(EXIT_SIGNAL + interrupted)
    if not all(row.safe for row in rows):
        raise typer.Exit(EXIT_FAILED)
