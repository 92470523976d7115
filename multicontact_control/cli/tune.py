"""`multicontact tune`."""

from __future__ import annotations

from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.cli.exits import errors_in_one_line, resumable
import typer


def tune(
    law: Annotated[str, typer.Argument(
        metavar='LAW', help='aob, pi, dob, lqg, admittance, impedance or feedforward.')],
    robot: options.Robot = '',
    plants: Annotated[str, typer.Option(
        help="Plants, with commas between; the worst of them counts; the robot's default if not "
        'given.')] = '',
    jobs: options.Jobs = 0, dask: options.Dask = '', out: options.StudyOut = None,
    dry_run: options.DryRun = False, overwrite: options.RunAgain = False,
) -> None:
    """
    Tune a force law: every combination of the gains in config/tuning.yaml, on seed 0.

    The best is judged on other seeds and written as a parameter file for --preset. Ctrl-C keeps
    what is finished; the same command goes on from there. Exit code 0, whatever comes out; 1:
    a worker died; 2: bad input; 130: interrupted.
    """
    with resumable(), errors_in_one_line():
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.scenario import plant_source, plants_of
        from multicontact_control.experiment.study.presets.tune.study import TuneStudy
        from multicontact_control.experiment.study.study import run_study, StudyOptions

        names = plants_of(robot, options.split_list(plants) or (plant_source('', robot).plant,))
        run_study(TuneStudy(law, names),
                  StudyOptions(out, jobs, dask, dry_run, overwrite))
