"""`multicontact sweep`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line, resumable
from multicontact_control.cli.options import split_list
from multicontact_control.errors import ConfigError
import typer


def sweep(
    study: Annotated[str, typer.Argument(
        metavar='STUDY', help='A name from config/studies (stiffness, delay) or the path of a '
        'YAML file.')],
    seeds: Annotated[str, typer.Option(
        help="How many seeds, from 0, or a list with commas; the study's own if not given.")] = '',
    jobs: Annotated[int, typer.Option(
        help='Runs at once on this machine; 0 for every core.')] = 0,
    dask: Annotated[str, typer.Option(
        metavar='ADDRESS', help='Run on the workers of this Dask scheduler instead, e.g. '
        'tcp://host:8786. They need this package in the same version.')] = '',
    out: Annotated[Path | None, typer.Option(
        help='Folder for the results; runs/sweep-<name> if not given. Runs that are finished '
        'there are not run again.')] = None,
    dry_run: Annotated[bool, typer.Option(
        '--dry-run', help='Only say how many runs there are, and how long they will take.',
    )] = False,
    overwrite: Annotated[bool, typer.Option(
        '--overwrite', help='Run everything again.')] = False,
) -> None:
    r"""
    Run parameters times seeds, and gather the summaries in one table.

    A study names scenario, plants, seeds, and values for parameters by their
    dotted names: controller, noise_estimator, plant or scenario, then the
    names in the YAML file of that:

      name: stiffness
      scenario: step
      plants: \[rigid, puma]
      seeds: 4   # 0 to 3; or a list
      grid:      # every combination; * is every contact
        noise_estimator.estimator: \[lead_window, fixed]
        plant.surfaces.*.stiffness:
          {start: 600, stop: 60000, count: 5, spacing: log}
      points:    # single combinations beside the grid
        - {controller.force.damping_rate: 10.0}

    Optional: description, duration (in s), supervised (false for `--bare` of
    simulate), fixed (parameters that are the same in every run), figures
    (columns to draw).

    Writes sweep.parquet (a row for each run, also for those that failed; units
    in the fields), sweep.png, sweep.html and timings.csv. The table is the same
    whatever number of workers made it. Ctrl-C keeps what is finished; the same
    command goes on from there.

    Exit code 0, whatever came out; 1: runs were lost; 2: bad input;
    130: interrupted.
    """
    with resumable(), errors_in_one_line():
        numbers = _seeds(seeds)
        from multicontact_control.experiment.sweep.run import sweep_and_report, SweepRequest

        sweep_and_report(SweepRequest(
            study=study, out=out, seeds=numbers, jobs=jobs, dask=dask, dry_run=dry_run,
            overwrite=overwrite))


def _seeds(text: str) -> tuple[int, ...] | None:
    """Return the seeds that a number or a list stands for, None for nothing."""
    if not text:
        return None
    try:
        numbers = [int(part) for part in split_list(text)]
    except ValueError:
        numbers = []
    if not numbers or min(numbers) < 0 or (',' not in text and numbers[0] < 1):
        raise ConfigError('seeds', 'a number of seeds, or seeds with commas between', f"'{text}'")
    return tuple(numbers) if ',' in text else tuple(range(numbers[0]))
