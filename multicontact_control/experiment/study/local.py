"""Jobs in processes of this machine, which may die without anything being lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
import os
import signal
from typing import Any

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.study.jobs import (
    JobResult,
    JobT,
    LostJob,
    Notify,
    Outcome,
)

SUSPECT = 2  # losses of a worker after which a job that was with one runs by itself


class LocalExecutor:
    """
    Processes of this machine, one numerical thread in each.

    A worker that dies takes the pool with it. It is then made anew, and goes on with what has no
    result yet. A job that was at work in two pools that died runs by itself; if the pool dies
    once more, the job is what killed it, and counts as lost.

    Parameters
    ----------
    workers
        How many; 1 runs everything in this process, 0 takes every core.

    Raises
    ------
    ConfigError
        If the number is not acceptable.

    """

    def __init__(self, workers: int = 0) -> None:
        check_workers(workers)
        self.workers = workers or usable_cores()

    def results(
        self, task: Callable[[JobT], JobResult], jobs: Sequence[JobT], notify: Notify,
    ) -> Generator[tuple[JobT, Outcome], None, None]:
        """Yield the outcome of every job as it comes; see `Executor.results`."""
        if self.workers == 1 or len(jobs) == 1:
            for job in jobs:
                yield job, task(job)
            return
        losses: Counter[JobT] = Counter()
        missing = dict.fromkeys(jobs)
        while missing:
            suspects = [job for job in missing if losses[job] >= SUSPECT]
            todo = suspects[:1] or sorted(missing, key=lambda job: -losses[job])
            given: list[JobT] = []
            try:
                with closing(_in_pool(task, _noting(todo, given), self.workers)) as pool:
                    for job, result in pool:
                        del missing[job]
                        yield job, result
            except BrokenProcessPool as error:
                _check_died(error)
                hit = [job for job in given if job in missing]
                losses.update(hit)
                notify(f'a worker died: {len(hit)} unfinished runs are started again')
            for job in [job for job in suspects[:1] if losses[job] > SUSPECT]:
                del missing[job]
                notify('a run killed its worker three times, the last time by itself: given up')
                yield job, LostJob('the process that ran it died three times')


def check_workers(workers: int) -> None:
    """Check a number of worker processes, 0 for every core; ConfigError if it is not one."""
    if workers < 0:
        raise ConfigError('jobs', 'a whole number >= 0', workers)


def _check_died(error: BrokenProcessPool) -> None:
    """Check that a pool broke because a worker died; RunError if it could not even start."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    if not isinstance(error, TerminatedWorkerError):
        cause = ' '.join(str(error.__cause__ or error).split())
        raise RunError(f'the workers cannot run anything: {cause[-300:]}') from None


def _in_pool(
    task: Callable[[JobT], JobResult], jobs: Iterable[JobT], workers: int,
) -> Generator[tuple[JobT, JobResult], None, None]:
    import joblib

    with joblib.parallel_config(backend='loky', inner_max_num_threads=1):
        # One job at a time: it takes far longer than handing it over, and is kept once done.
        parallel = joblib.Parallel(n_jobs=workers, return_as='generator_unordered', batch_size=1,
                                   pre_dispatch='2*n_jobs')
        yield from parallel(joblib.delayed(_with_job)(task, job) for job in jobs)


def _noting(jobs: Iterable[JobT], given: list[JobT]) -> Iterator[JobT]:
    """Yield jobs, noting which were asked for."""
    for job in jobs:
        given.append(job)
        yield job


def _with_job(task: Callable[[JobT], JobResult], job: JobT) -> tuple[JobT, JobResult]:
    # Ctrl-C reaches every process of the terminal; the one that gave out the work ends the rest.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return job, task(job)


def usable_cores() -> int:
    """Return how many cores this process may use."""
    affinity: Any = getattr(os, 'sched_getaffinity', None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1
