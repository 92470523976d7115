"""
Processes that start at once: forked from one that has loaded their modules already.

Loading its modules takes a node one to three seconds of a processor, more than anything else
until its first sample. Here one process loads those of all nodes, once, and is forked for every
node, and again for one that starts again. What runs is the `main` of the node's module, as by its
own command; a process is listed by that command, too.

Only what is single-threaded may be forked: this is why it is a process of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
import ctypes
from dataclasses import asdict, dataclass
import gc
from importlib import import_module
import json
import os
from pathlib import Path
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
from typing import IO, NoReturn

from multicontact_control.errors import RunError
from multicontact_control.process import FOLLOW_PARENT, THREAD_VARIABLES

# What is loaded for a node; nearly all of it is common to them.
MODULES = ('multicontact_control.nodes.recorder_node', 'sim_bridge.composed_sim_node')
# What a module looks at when it is loaded: no server serves two of these.
READ_WHEN_LOADED = ('LD_', 'NUMBA_', 'PYTHON', 'RMW_', *THREAD_VARIABLES)
ANSWER = struct.Struct('=3i')  # number of the request, process, exit code or RUNS
RUNS = 1 << 20
LARGEST_REQUEST = 1 << 20
# The name that a process is listed by fits in the room of its arguments and its environment.
ROOM_FOR_NAME = {'MULTICONTACT_ROOM': ' ' * 4096}


@dataclass(frozen=True)
class Request:
    """
    What a process is to be.

    Attributes
    ----------
    number
        Of the request.
    module
        Whose `main` it runs; its exit code is what that returns.
    command
        The command line that would do the same.
    name
        What the process calls itself, which is the first of its arguments.
    arguments
        The others.
    environment
        What is different from the environment of the server; None is not set.
    folder
        The working folder.

    """

    number: int
    module: str
    command: Sequence[str]
    name: str
    arguments: Sequence[str]
    environment: Mapping[str, str | None]
    folder: str


class ForkedProcess:
    """
    A process that a server was asked for, as `subprocess.Popen` has it.

    Parameters
    ----------
    on_end
        Called once it has ended, in a thread, process by process as they end.

    Attributes
    ----------
    returncode
        None until it has ended; the exit code, or the negative number of the signal that killed
        it. What ends with its server counts as killed.

    """

    def __init__(self, on_end: Callable[[ForkedProcess], None]) -> None:
        self.returncode: int | None = None
        self._on_end = on_end
        self._pid: int | None = None
        self._begun, self._ended = threading.Event(), threading.Event()

    @property
    def pid(self) -> int:
        """
        Return its number, as soon as it has one.

        Raises
        ------
        ProcessLookupError
            If the server has ended before.

        """
        self._begun.wait()
        if self._pid is None:
            raise ProcessLookupError
        return self._pid

    def take(self, pid: int, code: int) -> bool:
        """Take note of what the server says of it; return whether it has ended."""
        if code == RUNS:
            self._pid = pid
        else:
            self.returncode = code
            self._on_end(self)
            self._ended.set()
        self._begun.set()
        return code != RUNS

    def poll(self) -> int | None:
        """Return its exit code, None while it runs."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """
        Return its exit code once it has ended.

        Raises
        ------
        subprocess.TimeoutExpired
            If it has not after a time [s].

        """
        if not self._ended.wait(timeout) or self.returncode is None:
            raise subprocess.TimeoutExpired('a forked process', timeout or 0.0)
        return self.returncode

    def send_signal(self, number: signal.Signals) -> None:
        """Send it a signal, unless it has ended."""
        with contextlib.suppress(ProcessLookupError):
            pid = self.pid
            if self.returncode is None:
                os.kill(pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


class ForkServer:
    """
    A process that loads modules and is forked for every request; it ends with this one.

    Parameters
    ----------
    environment
        Its environment.
    modules
        What it loads. What cannot be found is left to the process that needs it, which then says
        so.

    Raises
    ------
    RunError
        If it cannot be started.

    """

    def __init__(
        self, environment: Mapping[str, str], modules: Sequence[str] = MODULES,
    ) -> None:
        self._environment = dict(environment)
        self._processes: dict[int, ForkedProcess] = {}
        self._lock = threading.Lock()
        self._requests = 0
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.runs = True
        with theirs:
            try:
                # In a session of its own it does not get the terminal's Ctrl-C: nodes are
                # stopped in order.
                self._server = subprocess.Popen(
                    [sys.executable, '-m', __name__, str(theirs.fileno()), *modules],
                    env={**environment, **ROOM_FOR_NAME}, pass_fds=(theirs.fileno(),),
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True)
            except OSError as error:
                raise RunError(f'{sys.executable}: cannot be started: {error}') from None
        threading.Thread(target=self._listen, daemon=True).start()

    def start(
        self, module: str, command: Sequence[str], name: str, arguments: Sequence[str],
        environment: Mapping[str, str], outputs: tuple[IO[bytes], IO[bytes]],
        on_end: Callable[[ForkedProcess], None] = lambda process: None,
    ) -> ForkedProcess:
        """
        Start a process in a session of its own.

        Parameters
        ----------
        module, command, name, arguments
            As in `Request`.
        environment
            The whole of it.
        outputs
            For what it writes to stdout and stderr.
        on_end
            As in `ForkedProcess`.

        Raises
        ------
        RunError
            If the server has ended.

        """
        removed = dict.fromkeys(self._environment.keys() - environment.keys())
        changed = {key: value for key, value in environment.items()
                   if self._environment.get(key) != value}
        process = ForkedProcess(on_end)
        with self._lock:
            self._requests += 1
            request = Request(self._requests, module, command, name, arguments,
                              {**removed, **changed}, os.getcwd())
            self._processes[request.number] = process
        try:
            socket.send_fds(self._channel, [json.dumps(asdict(request)).encode()],
                            [output.fileno() for output in outputs])
        except OSError as error:
            raise RunError(f'{name}: cannot be started: {error}') from None
        return process

    def close(self) -> None:
        """End it, and so what follows its parent."""
        with contextlib.suppress(OSError):
            self._channel.shutdown(socket.SHUT_RDWR)
        self._server.wait()

    def _listen(self) -> None:
        """Tell processes what becomes of them, until the server ends."""
        while answer := self._receive():
            number, pid, code = ANSWER.unpack(answer)
            if self._processes[number].take(pid, code):
                del self._processes[number]
        self.runs = False
        with self._lock:
            left, self._processes = self._processes, {}
        for process in left.values():
            process.take(0, -signal.SIGKILL)

    def _receive(self) -> bytes:
        try:
            return self._channel.recv(ANSWER.size)
        except OSError:  # it died with a request unread
            return b''


_servers: dict[tuple[object, ...], ForkServer] = {}


def fork_server(environment: Mapping[str, str]) -> ForkServer:
    """
    Return the server of this process for nodes in an environment; start it if there is none.

    Raises
    ------
    RunError
        If it cannot be started.

    """
    key = (os.getpid(), *sorted(
        item for item in environment.items() if item[0].startswith(READ_WHEN_LOADED)))
    server = _servers.get(key)
    if server is None or not server.runs:
        server = _servers[key] = ForkServer(environment)
    return server


def base_environment() -> dict[str, str]:
    """Return the environment of nodes, whichever graph they are of."""
    environment = dict(os.environ)
    for variable in THREAD_VARIABLES:
        environment.setdefault(variable, '1')
    environment['PYTHONUNBUFFERED'] = '1'
    root = Path(__file__).resolve().parents[3]
    if (root / 'package.xml').is_file():
        # A checkout that is run without being installed.
        paths = [str(root), *filter(None, environment.get('PYTHONPATH', '').split(os.pathsep))]
        environment['PYTHONPATH'] = os.pathsep.join(dict.fromkeys(paths))
    return environment


def _serve(channel: socket.socket, work: Iterator[object]) -> tuple[Request, list[int]]:
    """
    Fork for every request; return in each child what it is, and where it writes.

    As long as nobody asks for anything, `work` is done that the next one need not do.
    """
    numbers: dict[int, int] = {}
    ended, wake = socket.socketpair()
    for end in (ended, wake):
        end.setblocking(False)
    signal.set_wakeup_fd(wake.fileno())
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    idle = True
    while True:
        ready, _, _ = select.select([channel, ended], [], [], 0.0 if idle else None)
        if not ready:
            idle = next(work, None) is not None
        if ended in ready:
            ended.recv(4096)
            _tell_ends(channel, numbers)
        if channel in ready:
            text, outputs, _, _ = socket.recv_fds(channel, LARGEST_REQUEST, 2)
            if not text:
                sys.exit()  # what follows its parent is interrupted
            request = Request(**json.loads(text))
            pid = os.fork()
            if not pid:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                for end in (channel, ended, wake):
                    end.close()
                return request, outputs
            numbers[pid] = request.number
            for output in outputs:
                os.close(output)
            channel.send(ANSWER.pack(request.number, pid, RUNS))


def _tell_ends(channel: socket.socket, numbers: dict[int, int]) -> None:
    """Say which processes have ended, and how."""
    while numbers:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if not pid:
            return
        code = os.waitstatus_to_exitcode(status)
        channel.send(ANSWER.pack(numbers.pop(pid), pid, code))


def _become(request: Request, outputs: list[int]) -> NoReturn:
    """Be what a request asks for."""
    from setproctitle import setproctitle, setthreadtitle

    os.setsid()
    for stream, output in zip((1, 2), outputs):
        os.dup2(output, stream)
        os.close(output)
    os.chdir(request.folder)
    for name, value in request.environment.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
    if FOLLOW_PARENT in os.environ:
        os.environ[FOLLOW_PARENT] = str(os.getppid())
    sys.argv = [request.name, *request.arguments]
    sys.orig_argv = [sys.executable, *request.command[request.command[0] == sys.executable:]]
    setproctitle(' '.join(request.command))
    setthreadtitle(request.name)
    # What ROS calls its log by is within the command that has just been written over.
    libc = ctypes.CDLL(None)
    libc.strdup.restype = ctypes.c_void_p
    for variable in ('program_invocation_name', 'program_invocation_short_name'):
        with contextlib.suppress(ValueError):  # not every C library has it
            ctypes.c_void_p.in_dll(libc, variable).value = libc.strdup(request.name.encode())
    sys.exit(import_module(request.module).main())


def main() -> None:
    """Load modules and serve; the arguments are the number of the channel, and the modules."""
    channel = socket.socket(fileno=int(sys.argv[1]))
    channel.set_inheritable(False)
    if not getattr(sys.flags, 'safe_path', False):
        sys.path.pop(0)  # the folder where somebody is, which may have anything in it
    for name in ROOM_FOR_NAME:
        del os.environ[name]
    for module in ('setproctitle', *sys.argv[2:]):
        with contextlib.suppress(ImportError):  # who needs it says so
            import_module(module)
    gc.collect()
    gc.freeze()  # what is not written to stays shared
    try:
        # Never loaded where numba is not: that takes 0.3 s.
        kernels = sys.modules.get('multicontact_control.compiled')
        request, outputs = _serve(channel, kernels.load_stored() if kernels else iter(()))
    except ConnectionError:  # whom it serves has been killed
        sys.exit()
    _become(request, outputs)


if __name__ == '__main__':
    main()
