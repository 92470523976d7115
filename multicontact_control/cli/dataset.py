"""`multicontact dataset`, recordings for robot learning."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, TYPE_CHECKING

from multicontact_control.cli import options
from multicontact_control.errors import ConfigError
import typer

if TYPE_CHECKING:
    from multicontact_control.judging.results import LoadedRun


def dataset(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar='RUN',
            help='Folders of `run` or `simulate`, bag folders, or .mcap files.',
        ),
    ],
    out: Annotated[
        Path, typer.Option(help='Folder for the dataset, which is not there yet.')
    ],
    rate: Annotated[
        int,
        typer.Option(
            min=1,
            help='Frames per second [Hz], a whole part of the rate of the recordings.',
        ),
    ] = 50,
    tasks: Annotated[
        list[str] | None,
        typer.Option(
            '--task',
            metavar='TEXT',
            help='What the arm does, in words: once for all recordings, or once for each; if not '
            'given, the name of the scenario or recording.',
        ),
    ] = None,
    controller: options.ControllerFiles = None,
    namespace: options.Namespace = None,
) -> None:
    """
    Write recordings to a LeRobot dataset (v3.0): frames, each with its samples at the full rate.

    Each recording becomes an episode; one in which samples are missing for more than 0.1 s becomes
    one for each part. Recordings have the same joints, contacts and topics. Images are left out.
    """
    options.end_at_signals('interrupted; there is no dataset')
    from multicontact_control.judging.results import load
    from multicontact_control.learning.dataset import write_dataset

    if tasks is not None and len(tasks) not in (1, len(runs)):
        raise ConfigError(
            'tasks', f'1 text, or {len(runs)}, one for each RUN', len(tasks)
        )

    def load_runs() -> Iterator[tuple[LoadedRun, str]]:
        for number, path in enumerate(runs):
            run = load(path, controller or (), namespace)
            task = run.setup.scenario.name
            if tasks is not None:
                task = tasks[number % len(tasks)]
            yield run, task

    written = write_dataset(load_runs(), rate, out)
    for line in written.remarks:
        typer.echo(line)
    size = sum(path.stat().st_size for path in out.rglob('*') if path.is_file())
    typer.echo(
        f'{written.episodes} episodes, {written.frames} frames at {rate} Hz, '
        f'{size / 1e6:.1f} MB in {out}'
    )
