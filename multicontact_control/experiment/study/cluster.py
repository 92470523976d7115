"""Jobs on a Dask cluster."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Sequence
import concurrent.futures
from contextlib import suppress
import socket
import threading
from types import TracebackType
from typing import Any

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.study.jobs import (
    JobResult,
    JobT,
    LostJob,
    Notify,
    Outcome,
)

CONNECT_TIMEOUT = 10.0  # s, until an address counts as one that does not answer
AT_A_TIME = 500  # jobs handed to the scheduler in one message

LOST_CONNECTION = (
    asyncio.CancelledError, concurrent.futures.CancelledError, OSError, TimeoutError)

# The simulator and the compiled kernels are not for several threads of one process.
_ONE_AT_A_TIME = threading.Lock()


class DaskExecutor:
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

    def __enter__(self) -> DaskExecutor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
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

    gone = RunError('the Dask scheduler is gone or has dropped the work')
    try:
        if future.status == 'finished':
            result: JobResult = future.result()
            return result
        if future.status != 'error':
            raise gone
        error = future.exception()
    except LOST_CONNECTION:
        raise gone from None
    if isinstance(error, KilledWorker):
        return LostJob('the workers that were to run it died')
    reason = ' '.join(str(error).split()) or type(error).__name__
    raise RunError(f'a Dask worker cannot run the work: {reason}')
