"""Run every job that has no result yet: in processes of this machine, or on a Dask cluster."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
import concurrent.futures
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
import signal
import socket
import threading
from typing import Any, Generic

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.compilation import ensure_compiled
from multicontact_control.experiment.display import count_bar
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.jobs import JobResult, JobT
from rich.console import Console

WORKER_DIED = 'a worker died; the same command goes on with what is missing'
CONNECT_TIMEOUT = 10.0  # s, until an address counts as one that does not answer
LOST_CONNECTION = (asyncio.CancelledError, concurrent.futures.CancelledError, OSError)

# The simulator and the compiled kernels are not for several threads of one process.
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class JobRun(Generic[JobT]):
    """The jobs of a study, each with the key of its result in a folder."""

    folder: Path
    keys: Mapping[JobT, str]

    def result(self, job: JobT) -> JobResult:
        """Return the result of a job; RunError if it has none."""
        cache = JobCache(self.folder)
        result = cache.load(self.keys[job])
        if result is None:
            raise RunError(f'{cache.folder}/{self.keys[job]}: expected a finished job, found '
                           'none, or a damaged one')
        return result

    def metrics(self, job: JobT) -> dict[str, Any]:
        """Return what was measured in a job; RunError if it has no result."""
        return self.result(job).metrics


def run_jobs(
    jobs: Sequence[JobT], folder: Path, task: Callable[[JobT], JobResult], *,
    workers: int = 0, client: Any = None, console: Console | None = None, title: str = 'jobs',
) -> JobRun[JobT]:
    """
    Run every job that is not finished yet, one that comes twice once.

    Parameters
    ----------
    jobs, folder
        Of a study.
    task
        What a job is run with: an importable function.
    workers
        How many processes; 1 runs everything in this process, 0 takes every core.
    client
        Of a Dask cluster that runs them instead.
    console, title
        Where the progress bar is shown, with the time left, and what is said beside it.

    Raises
    ------
    ConfigError
        If a job's configuration is not acceptable, before anything is run.
    RunError
        If a worker or the cluster dies; what was finished before is kept.

    """
    cache = JobCache(folder)
    keys = {job: job.key() for job in jobs}
    todo = {key: job for job, key in keys.items() if cache.load(key) is None}
    if todo:
        ensure_compiled(console)  # here once, not in every worker at once
    with count_bar(console) as progress:
        total = len(set(keys.values()))
        bar = progress.add_task(title, total=total, completed=total - len(todo))
        if client is not None:
            work = _on_cluster(task, todo, client)
        elif len(todo) < 2 or workers_at_once(workers, None) == 1:
            work = ((key, task(job)) for key, job in todo.items())
        else:
            work = _in_processes(task, todo, workers)
        with closing(work) as results:
            for key, result in results:
                cache.save(key, todo[key], result)
                progress.advance(bar)
    return JobRun(folder, keys)


def _in_processes(
    task: Callable[[JobT], JobResult], todo: Mapping[str, JobT], workers: int,
) -> Generator[tuple[str, JobResult], None, None]:
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    with joblib.parallel_config(backend='loky', inner_max_num_threads=1):
        # One job at a time: it takes far longer than handing it over, and is kept once done.
        parallel = joblib.Parallel(n_jobs=workers or -1, return_as='generator_unordered',
                                   batch_size=1, pre_dispatch='2*n_jobs')
        try:
            yield from parallel(
                joblib.delayed(_in_worker)(task, key, job) for key, job in todo.items())
        except TerminatedWorkerError:
            raise RunError(WORKER_DIED) from None


def _in_worker(
    task: Callable[[JobT], JobResult], key: str, job: JobT,
) -> tuple[str, JobResult]:
    # Ctrl-C reaches every process of the terminal; the one that gave out the work ends the rest.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return key, task(job)


@contextmanager
def dask_client(address: str) -> Iterator[Any]:
    """
    Connect to the Dask scheduler at an address; yield None without one.

    Raises
    ------
    ConfigError
        If nothing answers there.
    RunError
        If `distributed` is not installed.

    """
    if not address:
        yield None
        return
    try:
        import distributed
        from distributed.comm import get_address_host_port
    except ImportError:
        raise RunError('a Dask cluster needs `distributed`, which is not installed here: '
                       "pip install 'multicontact_control[dask]'") from None
    try:
        # A client that is refused leaves threads that complain at the end of the program.
        socket.create_connection(get_address_host_port(address), CONNECT_TIMEOUT).close()
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = ' '.join(str(error).split()) or type(error).__name__
        raise ConfigError('dask', 'the address of a Dask scheduler that answers, e.g. '
                          'tcp://127.0.0.1:8786', f'{address} ({reason})') from None
    with client:
        yield client


def _on_cluster(
    task: Callable[[JobT], JobResult], todo: Mapping[str, JobT], client: Any,
) -> Generator[tuple[str, JobResult], None, None]:
    # Not joblib's Dask backend: it waits for ever for a job whose workers died (joblib 1.6).
    from distributed import as_completed, KilledWorker

    futures = client.map(_on_dask_worker, [task] * len(todo), todo.keys(), todo.values(),
                         pure=False, batch_size=500)
    try:
        for future in as_completed(futures, loop=client.loop):
            yield future.result()
            future.release()
    except KilledWorker:
        raise RunError(WORKER_DIED) from None
    except LOST_CONNECTION as error:
        raise RunError(f'the Dask cluster gives no results any more ({type(error).__name__}); '
                       'the same command goes on with what is missing') from None
    finally:
        with suppress(*LOST_CONNECTION):
            client.cancel(futures)


def _on_dask_worker(
    task: Callable[[JobT], JobResult], key: str, job: JobT,
) -> tuple[str, JobResult]:
    """Run a job where its key is the same, which stands for equal code and configuration."""
    with _ONE_AT_A_TIME:
        if job.key() != key:
            raise RunError('a Dask worker has other code, libraries or configuration files')
        return key, task(job)


def workers_at_once(workers: int, client: Any) -> int:
    """Return how many jobs run at once: the processes here, or the workers of a cluster."""
    if client is not None:
        return len(client.nthreads())
    from joblib import effective_n_jobs

    return int(effective_n_jobs(workers or -1))


def count_finished(jobs: Iterable[JobT], folder: Path) -> tuple[int, int]:
    """Return how many different jobs there are, and how many of them have a result."""
    keys = {job.key() for job in jobs}
    cache = JobCache(folder)
    return len(keys), sum(cache.load(key) is not None for key in keys)
