"""`multicontact faults`."""

from __future__ import annotations

from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.cli.exits import (
    errors_in_one_line,
    EXIT_FAILED,
    EXIT_SIGNAL,
    require_ros,
    resumable,
)
from multicontact_control.terminal import terminal
import typer


def faults(
    seed: Annotated[int, typer.Option(help='Seed of the first fault of every kind.')] = 0,
    quick: Annotated[bool, typer.Option(
        '--quick', help='One fault of each kind instead of 14.')] = False,
    graph: Annotated[bool, typer.Option(
        '--graph', help='Also kill nodes, damage messages and send wrong commands in a running '
        'ROS 2 graph, in real time; these are run anew each time.')] = False,
    robot: options.Robot = '', plants: options.Plants = '',
    jobs: options.Jobs = 0, dask: options.Dask = '', out: options.StudyOut = None,
    dry_run: options.DryRun = False, overwrite: options.RunAgain = False,
) -> None:
    """
    Break inputs and plant in many ways, and check that the arm stays safe.

    Writes faults.json and faults.html. Ctrl-C keeps what is finished; the same command goes on
    from there. Exit code 0: every fault was safe; 1: one was not, or was lost; 2: bad input;
    128 + n: ended by signal n.
    """
    interrupted = None
    with resumable(), errors_in_one_line():
        if graph:
            require_ros()
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.scenario import plants_of
        from multicontact_control.experiment.study.presets.faults.study import FaultStudy
        from multicontact_control.experiment.study.study import (
            report_study,
            run_study_jobs,
            StudyOptions,
        )

        names = plants_of(robot, options.split_list(plants))
        study, console = FaultStudy(seed, quick, graph, names), terminal()
        run = run_study_jobs(study, StudyOptions(out, jobs, dask, dry_run, overwrite), console)
        if run is None:
            return
        rows = study.content(run)
        if graph:
            from multicontact_control.experiment.faults.in_graph import run_graph_campaign

            over_graph, interrupted = run_graph_campaign(
                study.plants, seed, run.folder, quick=quick)
            rows += over_graph
        report_study(study, rows, run, console)
    if interrupted is not None:
        raise typer.Exit(EXIT_SIGNAL + interrupted)
    if not all(row.safe for row in rows):
        raise typer.Exit(EXIT_FAILED)
