"""Cells in processes of this machine, which may die without anything being lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
import os
import signal
from typing import Any

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.engine.cells import (
    CellResult,
    CellT,
    LostCell,
    Notify,
    Outcome,
)

SUSPECT = 2  # losses of a worker after which a cell that was with one runs by itself


class LocalExecutor:
    """
    Processes of this machine, one numerical thread in each.

    A worker that dies takes the pool with it. It is then made anew, and goes on with what has no
    result yet. A cell that was at work in two pools that died runs by itself; if the pool dies
    once more, the cell is what killed it, and counts as lost.

    Parameters
    ----------
    jobs
        How many; 1 runs everything in this process, 0 takes every core.

    Raises
    ------
    ConfigError
        If the number is not acceptable.

    """

    def __init__(self, jobs: int = 0) -> None:
        if jobs < 0:
            raise ConfigError('jobs', 'a whole number >= 0', jobs)
        self.jobs = jobs or usable_cores()

    def results(
        self, task: Callable[[CellT], CellResult], cells: Sequence[CellT], notify: Notify,
    ) -> Generator[tuple[CellT, Outcome], None, None]:
        """Yield the outcome of every cell as it comes; see `Executor.results`."""
        if self.jobs == 1 or len(cells) == 1:
            for cell in cells:
                yield cell, task(cell)
            return
        losses: Counter[CellT] = Counter()
        missing = dict.fromkeys(cells)
        while missing:
            suspects = [cell for cell in missing if losses[cell] >= SUSPECT]
            todo = suspects[:1] or sorted(missing, key=lambda cell: -losses[cell])
            given: list[CellT] = []
            try:
                with closing(_in_pool(task, _noting(todo, given), self.jobs)) as pool:
                    for cell, result in pool:
                        del missing[cell]
                        yield cell, result
            except BrokenProcessPool as error:
                _check_died(error)
                hit = [cell for cell in given if cell in missing]
                losses.update(hit)
                notify(f'a worker died: {len(hit)} unfinished runs are started again')
            for cell in [cell for cell in suspects[:1] if losses[cell] > SUSPECT]:
                del missing[cell]
                notify('a run killed its worker three times, the last time by itself: given up')
                yield cell, LostCell('the process that ran it died three times')


def _check_died(error: BrokenProcessPool) -> None:
    """Check that a pool broke because a worker died; RunError if it could not even start."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    if not isinstance(error, TerminatedWorkerError):
        cause = ' '.join(str(error.__cause__ or error).split())
        raise RunError(f'the workers cannot run anything: {cause[-300:]}') from None


def _in_pool(
    task: Callable[[CellT], CellResult], cells: Iterable[CellT], jobs: int,
) -> Generator[tuple[CellT, CellResult], None, None]:
    import joblib

    with joblib.parallel_config(backend='loky', inner_max_num_threads=1):
        # One cell at a time: it takes far longer than handing it over, and is kept once done.
        parallel = joblib.Parallel(n_jobs=jobs, return_as='generator_unordered', batch_size=1,
                                   pre_dispatch='2*n_jobs')
        yield from parallel(joblib.delayed(_with_cell)(task, cell) for cell in cells)


def _noting(cells: Iterable[CellT], given: list[CellT]) -> Iterator[CellT]:
    """Yield cells, noting which were asked for."""
    for cell in cells:
        given.append(cell)
        yield cell


def _with_cell(task: Callable[[CellT], CellResult], cell: CellT) -> tuple[CellT, CellResult]:
    # Ctrl-C reaches every process of the terminal; the one that gave out the work ends the rest.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return cell, task(cell)


def usable_cores() -> int:
    """Return how many cores this process may use."""
    affinity: Any = getattr(os, 'sched_getaffinity', None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1
