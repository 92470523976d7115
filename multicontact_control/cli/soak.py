"""`multicontact soak`."""

from __future__ import annotations

from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.cli.exits import (
    errors_in_one_line,
    EXIT_FAILED,
    require_ros,
    resumable,
)
import typer


def soak(
    hours: Annotated[float, typer.Option(
        help='Simulated hours, of all processes together.')] = 1.0,
    robot: options.Robot = '', plants: options.Plants = '',
    seed: Annotated[int, typer.Option(help='Seed of the first process.')] = 0,
    parts: Annotated[int, typer.Option(help='Processes per plant, which share the hours.')] = 1,
    graph: Annotated[bool, typer.Option(
        '--graph', help='Over running ROS 2 graphs, in real time and one after the other: nodes '
        'are killed, messages damaged, wrong commands sent. Run anew each time.')] = False,
    jobs: options.Jobs = 0, dask: options.Dask = '', out: options.StudyOut = None,
    dry_run: options.DryRun = False, overwrite: options.RunAgain = False,
) -> None:
    """
    Let random commands and faults happen for hours, and watch what must never be.

    No torque may be beyond its limits, no force beyond the ceiling for long, no force may
    oscillate, nothing may change its state more than twice a second, and after each fault all
    must be as commanded again, if need be with an operator's help. Memory and force error are
    noted every minute. Writes soak.json and soak.html. Ctrl-C keeps the soaks that are finished.
    Exit code 0: all was well; 1: it was not; 2: bad input; 130: interrupted.
    """
    with resumable(), errors_in_one_line():
        if graph:
            require_ros()
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.scenario import plants_of
        from multicontact_control.experiment.study.presets.soak.study import (
            GraphSoakStudy,
            is_good,
            SoakStudy,
        )
        from multicontact_control.experiment.study.study import run_study, StudyOptions

        study = GraphSoakStudy if graph else SoakStudy
        content = run_study(
            study(hours, plants_of(robot, options.split_list(plants)), seed, parts),
            StudyOptions(out, 1 if graph else jobs, dask, dry_run, overwrite or graph))
    if content is not None and not all(map(is_good, content)):
        raise typer.Exit(EXIT_FAILED)
