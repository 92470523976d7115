"""What carries out jobs: processes of this machine, or a Dask cluster; either may die."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
import concurrent.futures
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, closing, suppress
from dataclasses import dataclass
import os
import signal
import socket
import threading
from typing import Any, Protocol

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.study.jobs import JobResult, JobT
from multicontact_control.wording import counted

SUSPECT = 2  # losses of a worker after which a job that was with one runs by itself
CONNECT_TIMEOUT = 10.0  # s, until an address counts as one that does not answer
AT_A_TIME = 500  # jobs handed to the scheduler in one message
LOST_CONNECTION = (
    asyncio.CancelledError, concurrent.futures.CancelledError, OSError, TimeoutError)

# The simulator and the compiled kernels are not for several threads of one process.
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class LostJob:
    """A job without a result, because whatever process ran it died; and what happened."""

    reason: str


Outcome = JobResult | LostJob
Notify = Callable[[str], None]


class Executor(Protocol):
    """Carries out jobs somewhere."""

    @property
    def workers(self) -> int:
        """Return how many jobs run at once at present."""
        ...

    def results(
        self, task: Callable[[JobT], JobResult], jobs: Sequence[JobT], notify: Notify,
    ) -> Generator[tuple[JobT, Outcome], None, None]:
        """
        Yield the outcome of every job, in whatever order they come.

        Parameters
        ----------
        task
            An importable function.
        jobs
            What to call it with, each once.
        notify
            Is told in one line what the user should know, e.g. that a worker died.

        """
        ...


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
                notify(f'a worker died: {counted(len(hit), "unfinished runs")} to be started '
                       'again')
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


class DaskExecutor(AbstractContextManager['DaskExecutor']):
    """
    Whatever workers a Dask scheduler has; use it as a context manager.

    The scheduler runs the jobs of a worker that dies on another one. A worker process runs one
    job at a time, however many threads it has.

    Parameters
    ----------
    address
        Of the scheduler, e.g. ``tcp://127.0.0.1:8786``.

    Raises
    ------
    ConfigError
        If nothing answers there.
    RunError
        If `distributed` is not installed.

    """

    def __init__(self, address: str) -> None:
        try:
            import distributed
        except ImportError:
            raise RunError('a Dask cluster needs `distributed`, which is not installed here: '
                           "pip install 'multicontact_control[dask]'") from None
        try:
            _check_reachable(address)
            self._client: Any = distributed.Client(
                address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, ValueError) as error:
            reason = ' '.join(str(error).split()) or type(error).__name__
            raise ConfigError('dask', 'the address of a Dask scheduler that answers, e.g. '
                              'tcp://127.0.0.1:8786', f'{address} ({reason})') from None

    def __exit__(self, *_: object) -> None:
        self._client.close()

    @property
    def workers(self) -> int:
        """Return how many jobs run at once at present: the number of worker processes."""
        return len(self._client.nthreads())

    def results(
        self, task: Callable[[JobT], JobResult], jobs: Sequence[JobT], notify: Notify,
    ) -> Generator[tuple[JobT, Outcome], None, None]:
        """Yield the outcome of every job as it comes; see `Executor.results`."""
        if not self.workers:
            notify('the Dask cluster has no workers yet: waiting for them')
        doubtful = []
        for job, outcome in self._submitted(task, jobs, ''):
            if isinstance(outcome, LostJob):
                doubtful.append(job)
            else:
                yield job, outcome
        # The scheduler gives up on all that waited at workers that died, not only on what killed
        # them.
        for number, job in enumerate(doubtful):
            notify(f'the workers that were to run it died: run by itself ({number + 1} of '
                   f'{len(doubtful)})')
            yield from self._submitted(task, [job], '-alone')

    def _submitted(
        self, task: Callable[[JobT], JobResult], jobs: Sequence[JobT], suffix: str,
    ) -> Generator[tuple[JobT, Outcome], None, None]:
        """Yield what the scheduler makes of jobs, whose names there end in `suffix`."""
        from distributed import as_completed

        keys = [job.key() for job in jobs]
        futures = self._client.map(
            _run_checked, [task] * len(jobs), jobs, keys, pure=False, batch_size=AT_A_TIME,
            key=[f'{task.__name__}-{key}{suffix}' for key in keys])
        job_of = dict(zip((future.key for future in futures), jobs))
        try:
            for future in as_completed(futures, loop=self._client.loop):
                yield job_of[future.key], _outcome(future)
                future.release()
        finally:
            with suppress(*LOST_CONNECTION):
                self._client.cancel(futures)


def _check_reachable(address: str) -> None:
    """Connect to an address for a moment; OSError or ValueError if that cannot be done."""
    from distributed.comm import get_address_host_port, parse_address

    # A client that is refused leaves threads that complain at the end of the program.
    protocol, _ = parse_address(address)
    if protocol in ('tcp', 'tls'):
        socket.create_connection(get_address_host_port(address), CONNECT_TIMEOUT).close()


def _run_checked(task: Callable[[JobT], JobResult], job: JobT, key: str) -> JobResult:
    """Run a job where its key is the same, which stands for equal code and configuration."""
    with _ONE_AT_A_TIME:
        if job.key() != key:
            raise RunError('a worker has other code, libraries or configuration files')
        return task(job)


def _outcome(future: Any) -> Outcome:
    """Return what became of a job on the cluster."""
    from distributed import KilledWorker

    # Both wait: the worker that had the result may have died since, and another runs the job anew.
    try:
        error = future.exception()
        if error is None:
            result: JobResult = future.result()
            return result
    except LOST_CONNECTION:
        raise RunError('the Dask scheduler is gone or has dropped the work') from None
    except KilledWorker as killed:
        error = killed
    if isinstance(error, KilledWorker):
        return LostJob('the workers that were to run it died')
    reason = ' '.join(str(error).split()) or type(error).__name__
    raise RunError(f'a Dask worker cannot run the work: {reason}')
