"""Processes that are forked from one that has loaded their modules, held against plain ones."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
import signal
import subprocess
import sys

from multicontact_control.errors import RunError
from multicontact_control.experiment.graph.fork_server import (
    base_environment,
    fork_server,
    ForkServer,
)
from multicontact_control.process import FOLLOW_PARENT
import pytest
from ros_graph import PATIENCE, wait_for

TELLS = """
import ctypes, json, os, signal, sys
loaded_in = os.getpid()

def main():
    print('to stderr', file=sys.stderr)
    print(json.dumps({
        'arguments': sys.argv[1:], 'name': os.path.basename(sys.argv[0]), 'code': sys.orig_argv,
        'environment': dict(os.environ), 'folder': os.getcwd(),
        'called': ctypes.c_char_p.in_dll(
            ctypes.CDLL(None), 'program_invocation_name').value.decode(),
        'loaded here': loaded_in == os.getpid(), 'own session': os.getsid(0) == os.getpid(),
        'signals': [str(signal.getsignal(x)) for x in (
            signal.SIGINT, signal.SIGTERM, signal.SIGCHLD)],
        'files': sorted(os.listdir('/proc/self/fd')), 'input': sys.stdin.read()}))
    return 7

if __name__ == '__main__':
    sys.exit(main())
"""
SLEEPS = """
import time
from multicontact_control.nodes.runtime import follow_parent

def main():
    follow_parent()
    print('here')
    while True:
        time.sleep(0.1)
"""


class Started:
    """A server for two modules of the test's own, and what was started by it."""

    def __init__(self, folder):
        self.folder = folder
        (folder / 'tells.py').write_text(TELLS)
        (folder / 'sleeps.py').write_text(SLEEPS)
        self.environment = base_environment()
        self.environment['PYTHONPATH'] += f':{folder}'
        self.environment['TO_BE_REMOVED'] = 'x'
        self.server = ForkServer(self.environment, ('tells', 'multicontact_control.nodes.runtime'))
        self.ends, self._processes = [], []

    def start(self, module, *arguments, **environment):
        """Return a process, and the files with what it writes."""
        told = [self.folder / f'{module}.{stream}' for stream in ('out', 'err')]
        own = {**self.environment, **environment}
        del own['TO_BE_REMOVED']
        with told[0].open('wb') as output, told[1].open('wb') as errors:
            process = self.server.start(
                module, [sys.executable, '-m', module, *arguments], module, arguments, own,
                (output, errors), self.ends.append)
        self._processes.append(process)
        return process, *told

    def close(self):
        for process in self._processes:
            process.send_signal(signal.SIGKILL)  # nothing to one that has ended
        self.server.close()


@pytest.fixture
def started(tmp_path):
    made = Started(tmp_path)
    yield made
    made.close()


def test_forked_process_is_what_its_command_would_have_been(started, tmp_path, monkeypatch):
    elsewhere = tmp_path / 'elsewhere'
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    process, output, errors = started.start('tells', '--ros-args', 'a b', ONE='1')
    assert process.wait(PATIENCE) == process.returncode == process.poll() == 7
    environment = {**started.environment, 'ONE': '1'}
    del environment['TO_BE_REMOVED']
    plain = subprocess.run(
        [sys.executable, '-m', 'tells', '--ros-args', 'a b'], env=environment, text=True,
        capture_output=True, stdin=subprocess.DEVNULL, start_new_session=True)
    forked, reference = json.loads(output.read_text()), json.loads(plain.stdout)
    assert (forked.pop('loaded here'), reference.pop('loaded here')) == (False, True)
    assert (forked.pop('name'), reference.pop('name')) == ('tells', 'tells.py')
    assert forked.pop('called') == 'tells' and reference.pop('called') == sys.executable
    assert forked == reference
    assert errors.read_text() == plain.stderr == 'to stderr\n'


def test_process_is_listed_by_its_command(started):
    process, output, _ = started.start('sleeps', '--long', 'x' * 2000)
    wait_for(lambda: output.exists() and output.read_text(), 'the process to be there')
    listed = Path(f'/proc/{process.pid}/cmdline').read_text().rstrip('\0')
    assert listed == f'{sys.executable} -m sleeps --long {"x" * 2000}'
    assert Path(f'/proc/{process.pid}/comm').read_text() == 'sleeps\n'


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGTERM])
def test_ends_are_told_in_their_order_with_their_signals(started, number):
    processes = [started.start('sleeps')[0] for _ in range(3)]
    with pytest.raises(subprocess.TimeoutExpired):
        processes[0].wait(0.01)
    for k in (1, 0, 2):
        processes[k].send_signal(number)
        assert processes[k].wait(PATIENCE) == -number
        processes[k].send_signal(number)  # nothing to one that has ended
    assert started.ends == [processes[k] for k in (1, 0, 2)]


def test_module_that_is_not_there_is_told_by_the_process_that_needs_it(started):
    process, _, errors = started.start('no_such_module')
    assert process.wait(PATIENCE) == 1
    assert "No module named 'no_such_module'" in errors.read_text()


def test_server_that_is_killed_takes_what_follows_along(started):
    process, output, _ = started.start('sleeps', **{FOLLOW_PARENT: str(os.getpid())})
    wait_for(lambda: output.read_text(), 'the process to be there')
    pid = process.pid
    os.kill(started.server._server.pid, signal.SIGKILL)
    assert process.wait(PATIENCE) == -signal.SIGKILL
    wait_for(lambda: not Path(f'/proc/{pid}').exists(), 'the end of what follows')
    with pytest.raises(RunError, match='sleeps: cannot be started'):
        started.start('sleeps')


def test_server_and_what_follows_it_end_with_the_process_that_is_served(tmp_path):
    (tmp_path / 'sleeps.py').write_text(SLEEPS)
    program = (
        'import os, sys, time\n'
        'from multicontact_control.experiment.graph.fork_server import *\n'
        'from multicontact_control.experiment.graph.fork_server import FOLLOW_PARENT\n'
        'environment = {**base_environment(), FOLLOW_PARENT: "1"}\n'
        'server = fork_server(environment)\n'
        'log = open(sys.argv[1], "wb")\n'
        'process = server.start("sleeps", ["sleeps"], "sleeps", [], environment, (log, log))\n'
        'print(server._server.pid, process.pid, flush=True)\n'
        'time.sleep(1000)\n')
    environment = base_environment()
    environment['PYTHONPATH'] += f':{tmp_path}'
    log = tmp_path / 'log'
    parent = subprocess.Popen([sys.executable, '-c', program, str(log)], env=environment,
                              stdout=subprocess.PIPE, text=True)
    pids = parent.stdout.readline().split()
    wait_for(lambda: log.read_text(), 'the process to be there')
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert wait_for(lambda: not any(alive(pid) for pid in pids), 'the end of both')


def alive(pid):
    with contextlib.suppress(OSError):
        return ') Z ' not in Path(f'/proc/{pid}/stat').read_text()
    return False


def test_graphs_share_a_server_unless_modules_would_be_loaded_otherwise(monkeypatch):
    environment = base_environment()
    server = fork_server(environment)
    assert fork_server({**environment, 'ROS_DOMAIN_ID': '7'}) is server
    other = fork_server({**environment, 'NUMBA_DISABLE_JIT': '1'})
    assert other is not server
    other.close()
    wait_for(lambda: not other.runs, 'the end of the server')
    again = fork_server({**environment, 'NUMBA_DISABLE_JIT': '1'})
    assert again is not other and again.runs
    again.close()
