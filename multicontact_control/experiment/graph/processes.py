"""The processes of a graph: started, watched, stopped."""

from __future__ import annotations

from collections.abc import Collection, Mapping
import contextlib
import json
from pathlib import Path
import signal
import subprocess
import time
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.experiment.graph.node_process import NodeProcess
from multicontact_control.experiment.graph.spec import (
    CONTROLLER,
    ESTIMATOR,
    GraphSpec,
    MODULES,
    node_command,
    node_environment,
    RECORDER,
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

    def __init__(self, node_name: str, code: int, report: str) -> None:
        self.node_name, self.code = node_name, code
        super().__init__(report)


class NodeProcesses:
    """The processes of one graph in a ROS domain."""

    def __init__(self, spec: GraphSpec, domain_id: int) -> None:
        self._spec = spec
        self._environment = node_environment(spec, domain_id)
        self._running: dict[str, NodeProcess] = {}
        self._ends: list[str] = []  # names of those that have ended, in that order

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the nodes that were started and not ended from here."""
        return tuple(self._running)

    def start_all(self) -> None:
        """Start every node."""
        for name in self._spec.node_names:
            self.start(name)

    def start(self, name: str, parameters: Mapping[str, Any] | None = None) -> None:
        """Start a node, again if it has ended, with parameters over those of the graph."""
        self._ends = [other for other in self._ends if other != name]
        self._log_file(name).touch()  # it may be read before the node has opened it
        self._running[name] = NodeProcess(
            MODULES[name], node_command(name, self._spec, parameters),
            self._environment, self._log_file(name).resolve())

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
        return self._running[name].returncode is not None

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
        codes = {name: process.returncode for name, process in self._running.items()}
        self._ends += [name for name, code in codes.items()
                       if code is not None and name not in self._ends]
        for name in self._ends:
            code = codes.get(name)
            if code is not None and code not in allowed:
                raise NodeEndedError(name, code, self.report(name, ending(code)))

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

    def _log_file(self, name: str) -> Path:
        return self._spec.logs / f'{name}.log'

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


def _stop(processes: list[NodeProcess], signals: Signals) -> None:
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
