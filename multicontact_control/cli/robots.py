"""`multicontact robots`."""

from __future__ import annotations

from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.cli.exits import errors_in_one_line, resumable
import typer


def robots(
    robots: Annotated[str, typer.Option(
        help='Robots, with commas between: names from config/robots or paths; all whose URDF is '
        'installed if not given.')] = '',
    engines: Annotated[str, typer.Option(
        help='Engines, with commas between: pybullet, mujoco, mujoco-native (its own contacts); '
        'all that are installed if not given.')] = '',
    scenarios: Annotated[str, typer.Option(
        help='Scenarios, with commas between.')] = 'quick,moving_surface,curved,tilt',
    plant: Annotated[str, typer.Option(
        help='Which plant of each robot.')] = 'rigid',
    seeds: Annotated[int, typer.Option(help='Number of seeds, from 0.')] = 1,
    jobs: options.Jobs = 0, dask: options.Dask = '', out: options.StudyOut = None,
    dry_run: options.DryRun = False, overwrite: options.RunAgain = False,
) -> None:
    """
    Run every robot on every engine in every scenario, and table the true force errors.

    Writes robots.json and robots.html. Ctrl-C keeps what is finished; the same command goes on
    from there. Exit code 0, whatever came out; 1: a worker died; 2: bad input; 130: interrupted.
    """
    with resumable(), errors_in_one_line():
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.study.presets.robots.study import (
            known_engines,
            known_robots,
            RobotStudy,
        )
        from multicontact_control.experiment.study.study import run_study, StudyOptions

        run_study(RobotStudy(
            options.split_list(robots) or known_robots(),
            options.split_list(engines) or known_engines(), options.split_list(scenarios), plant,
            seeds), StudyOptions(out, jobs, dask, dry_run, overwrite))
