"""`multicontact study`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from multicontact_control.choices import LawChoice
from multicontact_control.cli import options
from multicontact_control.errors import ConfigError, run_all_checks
import typer


@dataclass(frozen=True)
class ChoiceOptions:
    """Options of `study`: which part of a study is run, and with what in the place of its own."""

    robot: options.Robot = ''
    plants: Annotated[
        str,
        typer.Option(
            help="Plants, with commas between: names, ROBOT/PLANT, or paths; the study's own "
            'if not given.'
        ),
    ] = ''
    seeds: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="How many seeds, from the study's first one on; the study's own if not "
            'given.',
        ),
    ] = None
    settings: Annotated[
        list[str] | None,
        typer.Option(
            '--set',
            metavar='FACTOR=VALUES',
            help='Values, or labels, with commas between, of a '
            'factor of the study, or of a parameter that becomes one; may be repeated.',
        ),
    ] = None
    law: Annotated[
        LawChoice | None,
        typer.Option(help='Force law whose gains the study `tune` tries.'),
    ] = None
    quick: Annotated[
        bool,
        typer.Option('--quick', help='The reduced form of the study, with one seed.'),
    ] = False


@dataclass(frozen=True)
class ExecutionOptions:
    """Options of `study`: where it is computed, and where its results go."""

    jobs: Annotated[
        int, typer.Option(min=0, help='Jobs at once on this machine; 0 for every core.')
    ] = 0
    dask: Annotated[
        str,
        typer.Option(
            metavar='ADDRESS',
            help='Run on the workers of this Dask scheduler instead, e.g. '
            'tcp://host:8786. They need this package in the same version.',
        ),
    ] = ''
    out: Annotated[
        Path | None,
        typer.Option(
            help='Folder for the results, runs/<name of the study> if not given. What is finished '
            'there is not run again.'
        ),
    ] = None
    dry_run: Annotated[
        bool,
        typer.Option(
            '--dry-run', help='List the factors, and how much of the study is finished.'
        ),
    ] = False
    overwrite: options.Overwrite = False


@options.flatten_options
def study(
    name: Annotated[
        str,
        typer.Argument(
            metavar='STUDY', help='One of the studies below, or a YAML file.'
        ),
    ],
    chosen: ChoiceOptions,
    execution: ExecutionOptions,
) -> None:
    r"""
    Run a study: factors x plants x seeds, in one table.

    A study of your own is a YAML file:

    \b
      name: stiffness
      scenario: step
      plants: [rigid, puma]
      seeds: 4   # 0 to 3; or a list
      factors:   # every combination; * is every contact
        noise_estimator.estimator: [lead_window, fixed]
        plant.surfaces.*.stiffness:
          {start: 600, stop: 60000, count: 5, spacing: log}

    Writes study.csv and study.parquet (a row for each run, also for those that failed),
    study.html, study.png and study.pdf. Ctrl-C keeps what is finished; the same command goes on
    from there. Exit code 1: a worker died, or something of `faults` or `situations` is not safe.
    """
    options.end_at_signals('interrupted; the same command goes on from there')
    # Only now: what is heavy is not loaded for the sake of an error.
    from multicontact_control.judging.run_folders import RUNS_FOLDER
    from multicontact_control.study import config as files
    from multicontact_control.study.presets import make_study
    from multicontact_control.study.study import run_study, show_plan
    from rich.console import Console

    texts = list(chosen.settings or ())
    if chosen.plants:
        texts.insert(0, f'plant={chosen.plants}')
    config, choices = run_all_checks(
        partial(files.read_study, name), partial(files.read_choices, texts)
    )
    if chosen.law and config.kind != 'tune':
        raise ConfigError('--law', hint='leave it out: only the study tune has it')
    robot = chosen.robot
    if robot and any('robot' in part.factors for part in config.parts.values()):
        choices = {'robot': [robot], **choices}
        robot = ''
    first_seed = config.seeds[0]
    shortened: dict[str, Sequence[Any]] = {}
    if chosen.quick:
        shortened = {'seed': [first_seed], **config.quick}
    if chosen.seeds:
        shortened['seed'] = range(first_seed, first_seed + chosen.seeds)
    selected = files.apply_choices(
        config.model_copy(update={'law': chosen.law or ''}),
        {**shortened, **choices},
        robot=robot,
    )
    planned = make_study(selected)
    folder = execution.out or RUNS_FOLDER / planned.config.name
    console = Console(highlight=False)
    if execution.dry_run:
        show_plan(planned, folder, console)
        return
    options.tell_missing_engine()
    results = run_study(
        planned,
        folder,
        console,
        jobs=execution.jobs,
        dask=execution.dask,
        overwrite=execution.overwrite,
    )
    if config.truth == 'safe' and not results.frame[config.truth].all():
        raise typer.Exit(options.EXIT_FAILED)
