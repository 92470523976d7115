"""The processes of a graph: started, watched, stopped."""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
import json
import signal
import subprocess
from typing import Any, IO

from multicontact_control.errors import RunError
from multicontact_control.experiment.graph_spec import (
    CONTROLLER,
    ESTIMATOR,
    GraphSpec,
    node_command,
    node_environment,
    RECORDER,
    SIM,
    START_ORDER,
    timing_file,
)

STOP_ORDER = (SIM, CONTROLLER, ESTIMATOR, RECORDER)
STOP_TIMEOUTS = ((signal.SIGINT, 6.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 2.0))
LOG_LINES = 12


class NodeEndedError(RunError):
    """A node has ended that should not have."""

    def __init__(self, node_name: str, obituary: str) -> None:
        self.node_name = node_name
        super().__init__(obituary)


class NodeProcesses:
    """
    The processes of one graph.

    Parameters
    ----------
    spec
        What to run.
    domain_id
        ROS domain it runs in.

    """

    def __init__(self, spec: GraphSpec, domain_id: int) -> None:
        self._spec = spec
        self._environment = node_environment(spec, domain_id)
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._logs: dict[str, IO[bytes]] = {}

    def start_all(self) -> None:
        """
        Start every node.

        Raises
        ------
        RunError
            If one cannot be started.

        """
        for name in self._spec.node_names:
            self._logs[name] = (self._spec.logs / f'{name}.log').open('wb')
            self.start(name)

    def start(self, name: str, parameters: Mapping[str, Any] | None = None) -> None:
        """Start a node, again if it has ended, with parameters over those of the graph."""
        try:
            # In a session of its own a node does not get the terminal's Ctrl-C: it is
            # stopped here, in order.
            self._running[name] = subprocess.Popen(
                node_command(name, self._spec, parameters), stdin=subprocess.DEVNULL,
                stdout=self._logs[name], stderr=subprocess.STDOUT, env=self._environment,
                start_new_session=True)
        except OSError as error:
            raise RunError(f'{name}: cannot be started: {error}') from None

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a signal to a node."""
        self._running[name].send_signal(number)

    def kill(self, name: str) -> None:
        """End a node at once; nobody will ask why it has ended."""
        process = self._running.pop(name)
        process.kill()
        process.wait()

    def end(self, name: str) -> int:
        """End a node as a run does at its end; return its exit code."""
        process = self._running.pop(name)
        self._stop_one(process)
        return process.wait()

    def ended(self, name: str) -> bool:
        """Return whether a node has ended."""
        return self._running[name].poll() is not None

    def raise_if_failed(self) -> None:
        """Raise if a node has ended other than with 0."""
        for name, process in self._running.items():
            code = process.poll()
            if code:
                raise RunError(self.obituary(name, ending(code)))

    def raise_if_gone(self) -> None:
        """Raise if a node has ended although the simulator has not, and nobody asked it to."""
        for name, process in self._running.items():
            code = process.poll()
            if code is not None and not self.ended(SIM):
                raise RunError(self.obituary(name, ending(code)))

    def raise_if_ended(self) -> None:
        """Raise if a node has ended, however, that was not ended from here."""
        for name, process in self._running.items():
            code = process.poll()
            if code is not None:
                raise NodeEndedError(name, self.obituary(name, ending(code)))

    def obituary(self, name: str, how: str) -> str:
        """Return what happened to a node, with the end of its log."""
        path = self._spec.logs / f'{name}.log'
        lines = path.read_text(encoding='utf-8', errors='replace').splitlines()[-LOG_LINES:]
        tail = '\n'.join(f'  {line}' for line in lines) or '  (nothing)'
        return f'{name} {how}; the end of {path}:\n{tail}'

    def stop(self) -> None:
        """Stop what still runs, one after the other, the recorder last."""
        for name in (*STOP_ORDER, *self._spec.extra_nodes):
            process = self._running.get(name)
            if process is not None:
                self._stop_one(process)
        for log in self._logs.values():
            log.close()

    @staticmethod
    def _stop_one(process: subprocess.Popen[bytes]) -> None:
        process.send_signal(signal.SIGCONT)  # one that is halted would not hear of it
        for number, timeout in STOP_TIMEOUTS:
            if process.poll() is not None:
                return
            process.send_signal(number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout)

    def timing(self) -> dict[str, dict[str, Any]]:
        """Return what each node wrote about its run; nothing for one that could not."""
        result = {}
        for name in START_ORDER:
            try:
                text = timing_file(self._spec, name).read_text(encoding='utf-8')
                result[name] = dict(json.loads(text))
            except (OSError, ValueError):
                result[name] = {}
        return result


def ending(code: int) -> str:
    """Return how a process with an exit code has ended."""
    return f'was killed by {signal.Signals(-code).name}' if code < 0 else (
        f'ended with exit code {code}')
