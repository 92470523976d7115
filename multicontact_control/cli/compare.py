"""`multicontact compare`."""

from __future__ import annotations

from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.cli.exits import errors_in_one_line, resumable
from multicontact_control.errors import ConfigError
import typer


def compare(
    quick: Annotated[bool, typer.Option(
        '--quick', help='A reduced matrix: four estimators, one seed, no runs without active '
        'state.')] = False,
    robot: options.Robot = '', plants: options.Plants = '',
    estimators: options.Estimators = '',
    seeds: Annotated[int | None, typer.Option(
        help='Number of seeds, from 0, or from 1 with --laws; 3 if not given, 1 with '
        '--quick.')] = None,
    jobs: options.Jobs = 0, dask: options.Dask = '', out: options.StudyOut = None,
    dry_run: options.DryRun = False, overwrite: options.RunAgain = False,
    laws: Annotated[bool, typer.Option(
        '--laws', help='Race force laws instead, each with its supervisor, in everything that a '
        'contact may meet: steps, pushes, sliding, a surface that vanishes, wrong stiffness, '
        'delay and friction.')] = False,
    preset: Annotated[str, typer.Option(
        help='Presets, with commas between: paper, best, adaptive, laws/pi and the like, or '
        'paths; with --laws all if not given, without it one, paper if not given.')] = '',
) -> None:
    """
    Compare the noise estimators on the paper's disturbances, with and without the active state.

    They run bare, the control law without its supervisor: its own limits are the point. With
    --laws force laws are compared instead, with the supervisor.

    Writes comparison.json and comparison.html, or laws.json and laws.html. Ctrl-C keeps what is
    finished; the same command goes on from there. Exit code 0, whatever the verdicts; 1: a worker
    died; 2: bad input; 130: interrupted.
    """
    with resumable(), errors_in_one_line():
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.scenario import plants_of
        from multicontact_control.experiment.study.presets.compare.study import ComparisonStudy
        from multicontact_control.experiment.study.study import run_study, StudyOptions

        study_options = StudyOptions(out, jobs, dask, dry_run, overwrite)
        names = plants_of(robot, options.split_list(plants))
        if laws:
            from multicontact_control.experiment.scenario import law_presets
            from multicontact_control.experiment.study.presets.laws.study import LawStudy

            if estimators:
                raise ConfigError('estimators', 'nothing with --laws', estimators)
            presets = options.split_list(preset) or law_presets()
            run_study(LawStudy(names, presets, seeds, quick), study_options)
            return
        run_study(
            ComparisonStudy(names, options.split_list(estimators), seeds, quick,
                            preset or 'paper'), study_options)
