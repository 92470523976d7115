"""
Many runs at once: cells, each described in full, run once, and kept in a folder.

A cell is named by the hash of everything that decides its outcome, so that an interrupted
matrix goes on where it stopped and a changed configuration is run again. What carries the cells
out is an `Executor`: processes of this machine here, anything with the same method elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import hashlib
import json
import os
from pathlib import Path
from typing import Any, Protocol
import zipfile

from multicontact_control import __version__
from multicontact_control.arrays import Matrix
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.results import write_json
from multicontact_control.experiment.scenario import resolve, Setup
import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

CELL_SCHEMA = 1  # to be raised when a cell's result means something else than before
CELL_FOLDER = 'cells'


@dataclass(frozen=True, slots=True, order=True)
class Cell:
    """
    One run, described in full; made by `cell_of`.

    Attributes
    ----------
    scenario, plant, seed
        As for `resolve`.
    overrides
        Canonical JSON of the other arguments of `resolve`.

    """

    scenario: str
    plant: str
    seed: int
    overrides: str = '{}'

    def setup(self) -> Setup:
        """Return everything the run needs, checked."""
        return resolve(self.scenario, plant=self.plant, seed=self.seed,
                       **json.loads(self.overrides))

    def key(self) -> str:
        """Return the hash of all that decides the outcome, whatever files it was read from."""
        setup = self.setup()
        content = {
            'schema': CELL_SCHEMA, 'version': __version__, 'seed': setup.seed,
            **{name: getattr(setup, name).model_dump(mode='json')
               for name in ('scenario', 'controller', 'noise_estimator', 'plant')}}
        text = json.dumps(content, sort_keys=True, separators=(',', ':'))
        return hashlib.sha256(text.encode()).hexdigest()[:24]


def cell_of(
    scenario: str, plant: str, seed: int, *, duration: float | None = None,
    noise_estimator: Mapping[str, Any] | None = None,
    controller: Mapping[str, Any] | None = None,
    plant_overrides: Mapping[str, Any] | None = None,
) -> Cell:
    """Return a cell; the arguments are those of `resolve`."""
    given = {'duration': duration, 'noise_estimator': noise_estimator, 'controller': controller,
             'plant_overrides': plant_overrides}
    kept = {name: value for name, value in given.items() if value}
    return Cell(scenario, plant, seed, json.dumps(kept, sort_keys=True, separators=(',', ':')))


@dataclass(frozen=True)
class CellResult:
    """
    What a cell leaves.

    Attributes
    ----------
    metrics
        JSON values; the same whatever ran the cell.
    traces
        Series by name, kept in single precision.
    wall_time
        Of the run [s].

    """

    metrics: dict[str, Any]
    traces: dict[str, Matrix]
    wall_time: float


CellTask = Callable[[Cell], CellResult]


class Executor(Protocol):
    """Carries out cells somewhere."""

    def results(
        self, task: CellTask, cells: Sequence[Cell],
    ) -> Iterator[tuple[Cell, CellResult]]:
        """
        Yield the result of every cell, in whatever order they come.

        Parameters
        ----------
        task
            An importable function.
        cells
            What to call it with.

        """
        ...


class LocalExecutor:
    """
    Processes of this machine, one numerical thread in each.

    Parameters
    ----------
    jobs
        How many; 1 runs everything in this process, 0 takes every core.

    """

    def __init__(self, jobs: int = 0) -> None:
        self.jobs = jobs or usable_cores()

    def results(
        self, task: CellTask, cells: Sequence[Cell],
    ) -> Iterator[tuple[Cell, CellResult]]:
        """Yield the result of every cell as it comes; see `Executor.results`."""
        if self.jobs == 1 or len(cells) == 1:
            for cell in cells:
                yield cell, task(cell)
            return
        import joblib

        with joblib.parallel_config(backend='loky', inner_max_num_threads=1):
            parallel = joblib.Parallel(
                n_jobs=min(self.jobs, len(cells)), return_as='generator_unordered',
                batch_size=1, pre_dispatch='2*n_jobs')
            yield from parallel(joblib.delayed(_with_cell)(task, cell) for cell in cells)


def usable_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _with_cell(task: CellTask, cell: Cell) -> tuple[Cell, CellResult]:
    return cell, task(cell)


class CellStore:
    """
    The finished cells of a folder: ``cells/<key>.json`` and ``cells/<key>.npz``.

    The JSON is written last and holds the hash of the traces, so a cell that was cut off while
    being written does not count as finished.

    Parameters
    ----------
    folder
        Where ``cells/`` is, or will be.

    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder / CELL_FOLDER

    def save(self, key: str, cell: Cell, result: CellResult) -> None:
        """Keep a result."""
        self.folder.mkdir(parents=True, exist_ok=True)
        traces: dict[str, Any] = {name: np.asarray(values, dtype=np.float32)
                                  for name, values in result.traces.items()}
        path = self.folder / f'{key}.npz'
        partial = path.with_suffix('.partial')
        with partial.open('wb') as file:
            np.savez_compressed(file, **traces)
        partial.replace(path)
        write_json(self.folder / f'{key}.json', {
            'schema': CELL_SCHEMA, 'key': key, 'scenario': cell.scenario, 'plant': cell.plant,
            'seed': cell.seed, 'overrides': json.loads(cell.overrides),
            'traces_sha256': _sha256(path), 'wall_s': result.wall_time,
            'metrics': result.metrics})

    def load(self, key: str) -> CellResult | None:
        """Return a result, None if it is not there or not whole."""
        path = self.folder / f'{key}.npz'
        try:
            content = json.loads((self.folder / f'{key}.json').read_text(encoding='utf-8'))
            if content['schema'] != CELL_SCHEMA or content['traces_sha256'] != _sha256(path):
                return None
            with np.load(path, allow_pickle=False) as data:
                traces = {name: data[name] for name in data.files}
            return CellResult(content['metrics'], traces, float(content['wall_s']))
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
            return None

    def finished(self, key: str) -> bool:
        """Return whether a whole result is there."""
        return self.load(key) is not None


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def run_cells(
    cells: Sequence[Cell], folder: Path, task: CellTask, *, executor: Executor | None = None,
    console: Console | None = None, title: str = 'cells',
) -> dict[Cell, str]:
    """
    Run every cell that is not finished yet.

    Parameters
    ----------
    cells
        The matrix; a cell that comes twice is run once.
    folder
        Where results are kept, and looked for.
    task
        What a cell is run with: an importable function.
    executor
        Who runs them; all cores of this machine if not given.
    console
        Where the progress bar is shown.
    title
        Left of the bar.

    Returns
    -------
    dict
        The key of every cell, for `CellStore.load`.

    Raises
    ------
    ConfigError
        If a cell's configuration is not acceptable, before anything is run.

    """
    store = CellStore(folder)
    keys = {cell: cell.key() for cell in cells}
    todo = list({key: cell for cell, key in keys.items() if not store.finished(key)}.values())
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(),
               TimeElapsedColumn(), TextColumn('left'), TimeRemainingColumn())
    with Progress(*columns, console=console, refresh_per_second=2,
                  speed_estimate_period=600.0) as progress:
        bar = progress.add_task(title, total=len(set(keys.values())),
                                completed=len(set(keys.values())) - len(todo))
        if todo:
            for cell, result in (executor or LocalExecutor()).results(task, todo):
                store.save(keys[cell], cell, result)
                progress.advance(bar)
    return keys


def prepare_cell_folder(folder: Path, *, overwrite: bool) -> None:
    """
    Make the folder of a matrix, keeping its finished cells unless they shall go.

    Raises
    ------
    ConfigError
        If it holds something else, or cannot be made.

    """
    if folder.is_dir() and any(folder.iterdir()) and not (folder / CELL_FOLDER).is_dir():
        raise ConfigError('out', 'a new or empty folder, or one with cells/',
                          f'{folder}, which holds other files')
    if overwrite and (folder / CELL_FOLDER).is_dir():
        for path in (folder / CELL_FOLDER).iterdir():
            if path.suffix in ('.json', '.npz', '.partial'):
                path.unlink()
    try:
        (folder / CELL_FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError('out', 'a folder that can be made',
                          f'{folder} ({error.strerror})') from None
