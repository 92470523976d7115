"""The processes of a graph: started, looked at, stopped."""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
import json
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import re
import signal
from textwrap import shorten
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.nodes.runtime import DISK_FULL_ERRORS
from multicontact_control.nodes.topics import RECORDER, SIM
from multicontact_control.runs.graph.node_process import MODULES, start_node
from multicontact_control.runs.graph.spec import (
    GraphSpec,
    node_arguments,
    START_ORDER,
)

# s, until a node that was asked to end is killed. On a busy machine a recorder takes seconds to
# write what has come; if it is killed, the bag has no end.
STOP_TIMEOUT = 8.0
RECORDER_TIMEOUT = 20.0
STOPPED = (0, -signal.SIGINT, -signal.SIGTERM)  # exit codes of nodes that were
LOG_LINES = 12
LINE_LENGTH = 230
WARNING = re.compile(r'\[(WARN|ERROR|FATAL)\] \[[\d.]+\] \[(\S+)\]: (.*)\n')


class NodeProcesses:
    """
    The processes of one graph in a ROS domain.

    `running` has those that were started, also after they have ended. Each writes into a log of
    its own, in the folder `logs` of the run.
    """

    def __init__(self, spec: GraphSpec, domain_id: int) -> None:
        self.spec = spec
        self.domain_id = domain_id
        self.running: dict[str, BaseProcess] = {}
        self._characters_read: dict[str, int] = {}  # of each log, for warnings
        spec.logs.mkdir(parents=True, exist_ok=True)

    def start(self, name: str, parameters: Mapping[str, Any] | None = None) -> None:
        """
        Start a node, or start it anew, with parameters over those of the graph.

        It returns at once; the node appends what it prints to its log.
        """
        log = self._log_file(name)
        log.touch()  # it may be read before the node has opened it
        self.running[name] = start_node(
            MODULES[name],
            node_arguments(name, self.spec, parameters),
            {**os.environ, 'ROS_DOMAIN_ID': str(self.domain_id)},
            log.resolve(),
            str(self.spec.out.resolve()),
        )

    def has_ended(self, name: str) -> bool:
        """
        Return whether a node was started and has ended.

        A node that was never started has not ended.
        """
        return name in self.running and self.running[name].exitcode is not None

    def check_running(self, *, stopped: bool = False) -> None:
        """
        Check that no node has ended but a simulator at its end; RunError with the end of its log.

        If they were `stopped`, a node that has ended as it was asked to is fine, too.
        """
        for name, process in self.running.items():
            code = process.exitcode
            at_its_end = name == SIM and code == 0
            as_asked = stopped and code in STOPPED
            if code is None or at_its_end or as_asked:
                continue
            if code in DISK_FULL_ERRORS:
                raise RunError(
                    f'{name}: {os.strerror(code)}; {self.spec.bag} has what was '
                    'recorded until then'
                )
            event = f'ended with exit code {code}'
            if code < 0:
                event = f'was killed by {signal.Signals(-code).name}'
            raise RunError(self.describe_end(name, event))

    def describe_end(self, name: str, event: str) -> str:
        """
        Return what happened to a node, an `event` in words, with the end of its log.

        The last 12 lines say more than an exit code, and the path leads to the rest.
        """
        lines = self._read_log(name).splitlines()
        if not lines:
            lines = ['(nothing)']
        tail = '\n'.join(f'  {line}' for line in lines[-LOG_LINES:])
        return f'{name} {event}; the end of {self._log_file(name)}:\n{tail}'

    def last_line(self, name: str) -> str:
        """
        Return the last line of a node's log, without time and name.

        It tells what a controller waits for that does not answer yet; empty if it has printed
        nothing.
        """
        text = self._read_log(name).rstrip('\n')
        return text.rpartition('\n')[2].rpartition(f'[{name}]: ')[2]

    def new_warnings(self) -> str:
        """
        Return the last warning or error that a node has logged since the last call.

        The line also says how many more there are, and where; it is empty if there is none.
        """
        warnings: list[tuple[str, ...]] = []
        for name in self.running:
            text = self._read_log(name)
            warnings += WARNING.findall(text, self._characters_read.get(name, 0))
            self._characters_read[name] = text.rfind('\n') + 1
        if not warnings:
            return ''
        line = shorten(': '.join(warnings[-1]), LINE_LENGTH)
        if len(warnings) > 1:
            line += f' (and {len(warnings) - 1} more in {self.spec.logs})'
        return line

    def _read_log(self, name: str) -> str:
        return self._log_file(name).read_text(encoding='utf-8', errors='replace')

    def _log_file(self, name: str) -> Path:
        return self.spec.logs / f'{name}.log'

    def stop(self, *, abort: bool = False) -> None:
        """
        Stop what runs, from the source downwards to the recorder.

        With `abort` no node waits until its messages have arrived. What does not end in time is
        killed.
        """
        for name in reversed(START_ORDER):
            if name in self.running:
                self._stop_node(name, abort)

    def _stop_node(self, name: str, abort: bool) -> None:
        process = self.running[name]
        number = signal.SIGINT
        timeout = STOP_TIMEOUT
        if name == RECORDER:
            timeout = RECORDER_TIMEOUT
        if abort or name == RECORDER:
            number = signal.SIGTERM
        if process.exitcode is None and process.pid is not None:
            with contextlib.suppress(ProcessLookupError):  # it has ended this moment
                os.kill(process.pid, number)
        process.join(timeout)
        process.kill()  # nothing to one that has ended
        process.join()

    def read_timing(self) -> dict[str, dict[str, Any]]:
        """
        Return what each node wrote about its run at its end: counts, times, events.

        The mapping of a node that was killed is empty.
        """
        timing: dict[str, dict[str, Any]] = {}
        for name in self.spec.nodes:
            file = self.spec.logs / f'{name}.json'
            timing[name] = {}
            if file.is_file():
                timing[name] = json.loads(file.read_text(encoding='utf-8'))
        return timing
