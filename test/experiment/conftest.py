"""A Dask cluster of real processes."""

from contextlib import suppress
from dataclasses import dataclass
import json
import os
import signal
import subprocess
import sys

import pytest
from ros_graph import PATIENCE, ROOT, wait_for


@dataclass(frozen=True)
class Cluster:
    """The address of a scheduler, its process and those of its workers."""

    address: str
    scheduler: subprocess.Popen
    workers: tuple


class Clusters:
    """The cluster that runs, if one does, and all processes of those that ran."""

    def __init__(self, folders):
        self._folders, self._processes, self._newest = folders, [], None

    def running(self):
        """Return a cluster with both workers; a new one if the scheduler of the last has died."""
        if self._newest is None or self._newest.scheduler.poll() is not None:
            self._newest = self._start(self._folders.mktemp('dask'))
        _wait_for_workers(self._newest.address)
        return self._newest

    def _start(self, folder):
        file = folder / 'scheduler.json'
        path = os.pathsep.join(filter(None, [
            str(ROOT), str(ROOT / 'test'), os.environ.get('PYTHONPATH')]))
        # One death may be an accident, two are not: with dask's own three, four workers would die.
        environment = {**os.environ, 'PYTHONPATH': path,
                       'DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES': '1'}
        started = []

        def start(role, *arguments):
            with (folder / f'{role}{len(started)}.log').open('w') as log:
                started.append(subprocess.Popen(
                    [sys.executable, '-m', f'distributed.cli.dask_{role}', '--scheduler-file',
                     str(file), '--host', '127.0.0.1', *arguments], env=environment, cwd=folder,
                    start_new_session=True, stdout=log, stderr=subprocess.STDOUT))
            self._processes.append(started[-1])

        start('scheduler', '--port', '0', '--no-dashboard')
        for _ in range(2):
            start('worker', '--nthreads', '1', '--no-dashboard', '--local-directory', str(folder))
        return Cluster(_address(file), started[0], tuple(started[1:]))

    def close(self):
        for process in self._processes:  # with their groups: a nanny has its worker in a process
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.fixture(scope='module')
def _clusters(tmp_path_factory):
    pytest.importorskip('distributed')
    clusters = Clusters(tmp_path_factory)
    yield clusters
    clusters.close()


@pytest.fixture
def dask_cluster(_clusters):
    """Have a scheduler and two workers with a thread each on this machine, for one file."""
    return _clusters.running()


def _address(file):
    """Wait for the scheduler, return its address."""
    def written():
        with suppress(OSError, ValueError):
            return json.loads(file.read_text())['address']

    return wait_for(written, 'address of the scheduler')


def _wait_for_workers(address):
    from distributed import Client

    with Client(address, set_as_default=False, timeout=PATIENCE) as client:
        client.wait_for_workers(2, timeout=PATIENCE)
