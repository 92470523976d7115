"""`multicontact faults`."""

from __future__ import annotations

from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.cli.exits import errors_in_one_line, EXIT_FAILED, resumable
import typer


def faults(
    seed: Annotated[int, typer.Option(help='Seed of the first fault of every kind.')] = 0,
    quick: Annotated[bool, typer.Option(
        '--quick', help='One fault of each kind instead of 14.')] = False,
    robot: options.Robot = '', plants: options.Plants = '',
    jobs: options.Jobs = 0, dask: options.Dask = '', out: options.StudyOut = None,
    dry_run: options.DryRun = False, overwrite: options.RunAgain = False,
) -> None:
    """
    Break inputs and plant in many ways, and check that the arm stays safe.

    Writes faults.json and faults.html. Ctrl-C keeps what is finished; the same command goes on
    from there. Exit code 0: every fault was safe; 1: one was not, or a worker died; 2: bad input;
    130: interrupted.
    """
    with resumable(), errors_in_one_line():
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.scenario import plants_of
        from multicontact_control.experiment.study.presets.faults.study import FaultStudy
        from multicontact_control.experiment.study.study import run_study, StudyOptions

        names = plants_of(robot, options.split_list(plants))
        rows = run_study(FaultStudy(seed, quick, plants=names),
                         StudyOptions(out, jobs, dask, dry_run, overwrite))
    if not all(row.safe for row in rows or ()):
        raise typer.Exit(EXIT_FAILED)
