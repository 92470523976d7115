"""Cells on a Dask cluster."""

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
from multicontact_control.experiment.engine.cells import (
    CellResult,
    CellT,
    LostCell,
    Notify,
    Outcome,
)

CONNECT_TIMEOUT = 10.0  # s, until an address counts as one that does not answer
AT_A_TIME = 500  # cells handed to the scheduler in one message

LOST_CONNECTION = (
    asyncio.CancelledError, concurrent.futures.CancelledError, OSError, TimeoutError)

# The simulator and the compiled kernels are not for several threads of one process.
_ONE_AT_A_TIME = threading.Lock()


class DaskExecutor:
    """
    Whatever workers a Dask scheduler has; use it as a context manager.

    The scheduler runs the cells of a worker that dies on another one. A worker process runs one
    cell at a time, however many threads it has.

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
    def jobs(self) -> int:
        """Return how many cells run at once at present: the number of worker processes."""
        return len(self._client.nthreads())

    def results(
        self, task: Callable[[CellT], CellResult], cells: Sequence[CellT], notify: Notify,
    ) -> Generator[tuple[CellT, Outcome], None, None]:
        """Yield the outcome of every cell as it comes; see `Executor.results`."""
        if not self.jobs:
            notify('the Dask cluster has no workers yet: waiting for them')
        doubtful = []
        for cell, outcome in self._submitted(task, cells, ''):
            if isinstance(outcome, LostCell):
                doubtful.append(cell)
            else:
                yield cell, outcome
        # The scheduler gives up on all that waited at workers that died, not only on what killed
        # them.
        for number, cell in enumerate(doubtful):
            notify(f'the workers that were to run it died: run by itself ({number + 1} of '
                   f'{len(doubtful)})')
            yield from self._submitted(task, [cell], '-alone')

    def _submitted(
        self, task: Callable[[CellT], CellResult], cells: Sequence[CellT], suffix: str,
    ) -> Generator[tuple[CellT, Outcome], None, None]:
        """Yield what the scheduler makes of cells, whose names there end in `suffix`."""
        from distributed import as_completed

        keys = [cell.key() for cell in cells]
        futures = self._client.map(
            _run_checked, [task] * len(cells), cells, keys, pure=False, batch_size=AT_A_TIME,
            key=[f'{task.__name__}-{key}{suffix}' for key in keys])
        cell_of = dict(zip((future.key for future in futures), cells))
        try:
            for future in as_completed(futures, loop=self._client.loop):
                yield cell_of[future.key], _outcome(future)
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


def _run_checked(task: Callable[[CellT], CellResult], cell: CellT, key: str) -> CellResult:
    """Run a cell where its key is the same, which stands for equal code and configuration."""
    with _ONE_AT_A_TIME:
        if cell.key() != key:
            raise RunError('a worker has other code, libraries or configuration files')
        return task(cell)


def _outcome(future: Any) -> Outcome:
    """Return what became of a cell on the cluster."""
    from distributed import KilledWorker

    gone = RunError('the Dask scheduler is gone or has dropped the work')
    try:
        if future.status == 'finished':
            result: CellResult = future.result()
            return result
        if future.status != 'error':
            raise gone
        error = future.exception()
    except LOST_CONNECTION:
        raise gone from None
    if isinstance(error, KilledWorker):
        return LostCell('the workers that were to run it died')
    reason = ' '.join(str(error).split()) or type(error).__name__
    raise RunError(f'a Dask worker cannot run the work: {reason}')
