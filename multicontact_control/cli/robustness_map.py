"""`multicontact map`."""

from __future__ import annotations

from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.cli.exits import errors_in_one_line, resumable
import typer


def robustness_map(
    quick: Annotated[bool, typer.Option(
        '--quick', help='Two estimators on the first plant, a coarse grid.')] = False,
    robot: options.Robot = '', plants: options.Plants = '',
    estimators: options.Estimators = '',
    jobs: options.Jobs = 0, dask: options.Dask = '', out: options.StudyOut = None,
    dry_run: options.DryRun = False, overwrite: options.RunAgain = False,
) -> None:
    """
    Map how wrong stiffness and delay may be, simulated and by the linear loop.

    True stiffness 0.1 to 20 times the model's, actuator delay 0 to 3 periods. Everything runs
    bare, the control law without its supervisor: its own limits are the point. Writes
    robustness.json, robustness.png and robustness.html. Ctrl-C keeps what is finished; the same
    command goes on from there. Exit code 0, whatever came out; 1: a worker died; 2: bad input;
    130: interrupted.
    """
    with resumable(), errors_in_one_line():
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.scenario import plants_of
        from multicontact_control.experiment.study.presets.robustness.study import (
            robustness_study,
        )
        from multicontact_control.experiment.study.study import run_study, StudyOptions

        names = plants_of(robot, options.split_list(plants))
        run_study(
            robustness_study(names[:1] if quick and not plants else names,
                             options.split_list(estimators), quick=quick),
            StudyOptions(out, jobs, dask, dry_run, overwrite))
