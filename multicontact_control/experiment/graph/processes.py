"""The processes of a graph: started, watched, stopped."""

from __future__ import annotations

from collections.abc import Collection, Mapping
import contextlib
import json
import signal
import subprocess
import time
from typing import Any, IO

from multicontact_control.errors import RunError
from multicontact_control.experiment.graph.fork_server import fork_server, ForkedProcess
from multicontact_control.experiment.graph.spec import (
    CONTROLLER,
    ESTIMATOR,
    GraphSpec,
    MODULES,
    node_command,
    node_environment,
    RECORDER,
    ROS_ARGUMENTS,
    SIM,
    timing_file,
)

Signals = tuple[tuple[signal.Signals, float], ...]  # with the time that is left for each [s]

STOP_ORDER = (SIM, CONTROLLER, ESTIMATOR, RECORDER)
# A node that is interrupted sends what it has to send and waits until that has arrived; one that
# is terminated closes its files, and waits for nobody.
STOP_SIGNALS = ((signal.SIGINT, 6.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 2.0))
ABORT_SIGNALS = ((signal.SIGTERM, 1.0), (signal.SIGKILL, 1.0))
# A recorder that is killed leaves a bag without its end and its metadata, and on a busy machine it
# takes seconds to write what has come.
RECORDER_SIGNALS = ((signal.SIGTERM, 20.0), (signal.SIGKILL, 2.0))
STOPPED = (0, -signal.SIGINT, -signal.SIGTERM)  # exit codes of nodes that were
LOG_LINES = 12


class NodeEndedError(RunError):
    """A node has ended that should not have."""

    def __init__(self, node_name: str, report: str) -> None:
        self.node_name = node_name
        super().__init__(report)


class NodeProcesses:
    """The processes of one graph in a ROS domain."""

    def __init__(self, spec: GraphSpec, domain_id: int) -> None:
        self._spec = spec
        self._environment = node_environment(spec, domain_id)
        self._running: dict[str, ForkedProcess] = {}
        self._ends: list[ForkedProcess] = []  # in the order in which they ended
        self._logs: dict[str, IO[bytes]] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the nodes that were started and not ended from here."""
        return tuple(self._running)

    def start_all(self) -> None:
        """
        Start every node.

        Raises
        ------
        RunError
            If one cannot be started.

        """
        for process, names in self._spec.processes.items():
            self._logs[process] = self._log_file(names[0]).open('wb')
            self.start(process)

    def start(self, name: str, parameters: Mapping[str, Any] | None = None) -> None:
        """Start a process, again if it has ended, with parameters over those of the graph."""
        command, log = node_command(name, self._spec, parameters), self._logs[name]
        process = fork_server(self._environment).start(
            MODULES[name], command, name, command[command.index(ROS_ARGUMENTS):],
            self._environment, (log, log), self._ends.append)
        for member in self._spec.processes[name]:
            self._running[member] = process

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a signal to a node."""
        self._running[name].send_signal(number)

    def kill(self, name: str) -> None:
        """End a node at once; its end is then no failure."""
        process = self._running.pop(name)
        process.kill()
        process.wait()

    def end(self, name: str) -> int:
        """End a node as a run does at its end; return its exit code."""
        process = self._running.pop(name)
        _stop([process], _signals_to(name))
        return process.wait()

    def ended(self, name: str) -> bool:
        """Return whether a node has ended."""
        return self._running[name] in self._ends

    def raise_if_ended(self, *, at_its_end: bool = False) -> None:
        """
        Check that every node still runs, except those that were ended from here.

        Parameters
        ----------
        at_its_end
            Whether the run is at its end once the simulator has ended with exit code 0: then the
            others may, too.

        Raises
        ------
        NodeEndedError
            About the one that ended first.

        """
        allowed = at_its_end and not self._spec.external and self.ended(SIM)
        self._raise_unless((0,) if allowed else ())

    def raise_if_failed(self) -> None:
        """
        Check that no node has failed, not even while it was stopped.

        Raises
        ------
        NodeEndedError
            About the one that failed first.

        """
        self._raise_unless(STOPPED)

    def _raise_unless(self, allowed: Collection[int]) -> None:
        """Raise an error about the first node that has ended with another exit code."""
        names = {process: self._spec.process_of(name) for name, process in self._running.items()}
        # The end of one that was stopped may not have been noted yet.
        for process in [x for x in dict.fromkeys((*self._ends, *names)) if x in names]:
            name, code = names[process], process.returncode
            if code is not None and code not in allowed:
                raise NodeEndedError(name, self.report(name, ending(code)))

    def report(self, name: str, how: str) -> str:
        """Return what happened to a node, with the end of its log."""
        lines = self._log(name)[-LOG_LINES:]
        tail = '\n'.join(f'  {line}' for line in lines) or '  (nothing)'
        return f'{name} {how}; the end of {self._log_file(name)}:\n{tail}'

    def last_line(self, name: str) -> str:
        """Return what a node has said last, without time and name; empty if nothing yet."""
        lines, mark = self._log(name), f'[{name}]: '
        said = [line for line in lines if mark in line] or [line for line in lines if line.strip()]
        return said[-1].rpartition(mark)[2] if said else ''

    def _log(self, name: str) -> list[str]:
        return self._log_file(name).read_text(encoding='utf-8', errors='replace').splitlines()

    def _log_file(self, name: str) -> Any:
        return self._spec.logs / f'{self._spec.process_of(name)}.log'

    def stop(self, *, abort: bool = False) -> None:
        """
        Stop what still runs.

        Parameters
        ----------
        abort
            Whether to end all at once, the recorder last, instead of one after the other, so
            that every message that was sent is in the bag.

        """
        names = [x for x in STOP_ORDER if x in self._running]
        if abort:
            _stop([self._running[x] for x in names if x != RECORDER], ABORT_SIGNALS)
            names = [x for x in names if x == RECORDER]
        for name in names:
            _stop([self._running[name]], _signals_to(name))
        for log in self._logs.values():
            log.close()

    def timing(self) -> dict[str, dict[str, Any]]:
        """Return what each node wrote about its run; nothing for one that could not."""
        result = {}
        for name in self._spec.peers:
            try:
                text = timing_file(self._spec, name).read_text(encoding='utf-8')
                result[name] = dict(json.loads(text))
            except (OSError, ValueError):
                result[name] = {}
        return result


def _signals_to(name: str) -> Signals:
    return RECORDER_SIGNALS if name == RECORDER else STOP_SIGNALS


def _stop(processes: list[ForkedProcess], signals: Signals) -> None:
    """Send some processes one signal after the other, until they have ended."""
    for process in processes:
        process.send_signal(signal.SIGCONT)  # one that is halted would not hear of the others
    for number, timeout in signals:
        for process in processes:
            process.send_signal(number)  # nothing to one that has ended
        give_up = time.monotonic() + timeout
        for process in processes:
            with contextlib.suppress(subprocess.TimeoutExpired):  # the next signal, then
                process.wait(max(0.0, give_up - time.monotonic()))


def ending(code: int) -> str:
    """Return how a process with an exit code has ended."""
    return f'was killed by {signal.Signals(-code).name}' if code < 0 else (
        f'ended with exit code {code}')
