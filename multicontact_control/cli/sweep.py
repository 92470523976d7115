"""`multicontact sweep`."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from multicontact_control.cli import options
from multicontact_control.cli.exits import errors_in_one_line, resumable
from multicontact_control.errors import check_all, ConfigError
import typer


def sweep(
    study: Annotated[str, typer.Argument(
        metavar='STUDY',
        help='A name from config/studies (stiffness, delay) or the path of a '
        'YAML file.')],
    seeds: Annotated[str, typer.Option(
        help="How many seeds, from 0, or a list with commas; the study's own if not given.")] = '',
    robot: options.Robot = '', jobs: options.Jobs = 0, dask: options.Dask = '',
    out: options.StudyOut = None,
    dry_run: options.DryRun = False, overwrite: options.RunAgain = False,
) -> None:
    """
    Run parameters times seeds, and gather the summaries in one table.

    A study names scenario, plants, seeds, and values for parameters by their
    dotted names: controller, noise_estimator, plant or scenario, then the
    names in the YAML file of that:

      name: stiffness
      scenario: step
      plants: [rigid, puma]
      seeds: 4   # 0 to 3; or a list
      grid:      # every combination; * is every contact
        noise_estimator.estimator: [lead_window, fixed]
        plant.surfaces.*.stiffness:
          {start: 600, stop: 60000, count: 5, spacing: log}
      points:    # single combinations beside the grid
        - {controller.force.damping_rate: 10.0}

    Optional: description, duration (in s), supervised (false for `--bare` of
    simulate), fixed (parameters that are the same in every run), figures
    (columns to draw).

    Writes sweep.parquet (a row for each run, also for those that failed; units
    in the fields), sweep.png and sweep.html. The table is the same whatever
    number of workers made it. Ctrl-C keeps what is finished; the same
    command goes on from there.

    Exit code 0, whatever came out; 1: a worker died; 2: bad input;
    130: interrupted.
    """
    with resumable(), errors_in_one_line():
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.study.presets.sweep.config import study_path
        from multicontact_control.experiment.study.presets.sweep.study import sweep_study
        from multicontact_control.experiment.study.study import run_study, StudyOptions

        asked = StudyOptions(out, jobs, dask, dry_run, overwrite)
        check_all(partial(study_path, study), partial(_seeds, seeds), asked.check)
        run_study(sweep_study(study, _seeds(seeds), robot), asked)


def _seeds(text: str) -> tuple[int, ...] | None:
    """Return the seeds that a number or a list stands for, None for nothing."""
    if not text:
        return None
    try:
        numbers = [int(part) for part in options.split_list(text)]
    except ValueError:
        numbers = []
    if not numbers or min(numbers) < 0 or (',' not in text and numbers[0] < 1):
        raise ConfigError('seeds', 'a number of seeds, or seeds with commas between', f"'{text}'")
    return tuple(numbers) if ',' in text else tuple(range(numbers[0]))
