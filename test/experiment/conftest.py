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


@pytest.fixture
def dask_cluster(tmp_path_factory):
    """Start a scheduler and two workers with a thread each on this machine, end them after."""
    pytest.importorskip('distributed')
    folder = tmp_path_factory.mktemp('dask')
    file = folder / 'scheduler.json'
    path = os.pathsep.join(filter(None, [
        str(ROOT), str(ROOT / 'test'), os.environ.get('PYTHONPATH')]))
    environment = {**os.environ, 'PYTHONPATH': path}
    processes = []

    def start(role, *arguments):
        with (folder / f'{role}{len(processes)}.log').open('w') as log:
            processes.append(subprocess.Popen(
                [sys.executable, '-m', f'distributed.cli.dask_{role}', '--scheduler-file',
                 str(file), '--host', '127.0.0.1', *arguments], env=environment, cwd=folder,
                start_new_session=True, stdout=log, stderr=subprocess.STDOUT))

    start('scheduler', '--port', '0', '--no-dashboard')
    for _ in range(2):
        start('worker', '--nthreads', '1', '--no-dashboard', '--local-directory', str(folder))
    try:
        yield Cluster(_address(file), processes[0], tuple(processes[1:]))
    finally:
        for process in processes:  # with their groups: a nanny has its worker in a process
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _address(file):
    """Wait for the scheduler and both workers, return the address."""
    from distributed import Client

    def written():
        with suppress(OSError, ValueError):
            return json.loads(file.read_text())['address']

    address = wait_for(written, 'address of the scheduler')
    with Client(address, set_as_default=False, timeout=PATIENCE) as client:
        client.wait_for_workers(2, timeout=PATIENCE)
    return address
