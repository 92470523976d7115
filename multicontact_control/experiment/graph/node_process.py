"""
Nodes as processes that start at once: forked from one that has loaded their modules already.

Loading its modules takes a node one to three seconds of a processor. The process that
`multiprocessing` forks from loads them once. What runs is the `main` of the node's module, as by
its own command; a process is listed by that command, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import contextlib
import ctypes
from importlib import import_module
import multiprocessing
from multiprocessing import forkserver
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading

from multicontact_control.process import limit_threads

PRELOAD = 'multicontact_control.experiment.graph.preload'
# The command line that a node is listed by fits in the room of its server's environment.
ROOM = 'MULTICONTACT_ROOM'
CONTEXT = multiprocessing.get_context('forkserver')


def prepare_nodes() -> None:
    """Begin to load what every node needs, in another process; of use before anything heavy."""
    limit_threads()
    root = Path(__file__).resolve().parents[3]
    if (root / 'package.xml').is_file():
        # A checkout that is run without being installed.
        paths = [str(root), *filter(None, os.environ.get('PYTHONPATH', '').split(os.pathsep))]
        os.environ['PYTHONPATH'] = os.pathsep.join(dict.fromkeys(paths))
    CONTEXT.set_forkserver_preload([PRELOAD])
    os.environ[ROOM] = ' ' * 4096
    forkserver.ensure_running()
    del os.environ[ROOM]


class NodeProcess:
    """
    A node in a process of its own, as `subprocess.Popen` has it.

    Parameters
    ----------
    module
        Whose `main` it runs; its exit code is what that returns.
    command
        Command line that does the same: what it is listed by.
    environment
        The whole of it.
    log
        File that it writes to.

    """

    def __init__(
        self, module: str, command: Sequence[str], environment: Mapping[str, str], log: Path,
    ) -> None:
        prepare_nodes()
        self.args = list(command)
        self._process = CONTEXT.Process(
            target=_run, args=(module, self.args, dict(environment), str(log)), daemon=True)
        self._process.start()

    @property
    def pid(self) -> int:
        """Return its number."""
        return int(self._process.pid or 0)

    @property
    def returncode(self) -> int | None:
        """Return its exit code, or the negative number of a signal; None while it runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """Return the same."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """
        Return its exit code once it has ended.

        Raises
        ------
        subprocess.TimeoutExpired
            If it has not after a time [s].

        """
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        return int(self._process.exitcode)

    def send_signal(self, number: signal.Signals) -> None:
        """Send it a signal, unless it has ended."""
        if self.returncode is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


def _run(module: str, command: list[str], environment: dict[str, str], log: str) -> None:
    """Be the node that a command starts."""
    from setproctitle import setproctitle, setthreadtitle

    os.setsid()
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    output = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    for stream in (1, 2):
        os.dup2(output, stream)
    os.close(output)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    os.environ.clear()
    os.environ.update(environment)
    threading.Thread(target=_follow_parent, daemon=True).start()
    name = Path(command[0]).name if command[0] != sys.executable else command[2].rpartition('.')[2]
    sys.argv = [name, *command[1 if command[0] != sys.executable else 3:]]
    setproctitle(' '.join(command))
    setthreadtitle(name)
    _name_logs(name)
    sys.exit(import_module(module).main())


def _name_logs(name: str) -> None:
    """Let ROS call the file of its log by a name: what it reads has just been written over."""
    libc = ctypes.CDLL(None)
    libc.strdup.restype = ctypes.c_void_p
    with contextlib.suppress(ValueError):  # not every C library has it
        ctypes.c_void_p.in_dll(libc, 'program_invocation_name').value = libc.strdup(name.encode())


def _follow_parent() -> None:
    """Interrupt this process when the one that started it has ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGINT)
