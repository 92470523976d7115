"""The processes of a graph: started, looked at, stopped."""

from __future__ import annotations

from collections import Counter
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
STOP_TIMEOUT, RECORDER_TIMEOUT = 8.0, 20.0
STOPPED = (0, -signal.SIGINT, -signal.SIGTERM)  # exit codes of nodes that were
LOG_LINES, LINE_LENGTH = 12, 230
WARNING = re.compile(r'\[(WARN|ERROR|FATAL)\] \[[\d.]+\] \[(\S+)\]: (.*)\n')


class NodeProcesses:
    """The processes of one graph in a ROS domain; `running` has those that were started."""

    def __init__(self, spec: GraphSpec, domain_id: int) -> None:
        self.spec, self.domain_id = spec, domain_id
        spec.logs.mkdir(parents=True, exist_ok=True)
        self.running: dict[str, BaseProcess] = {}
        self._seen: Counter[str] = Counter()  # characters of each log

    def start(self, name: str, parameters: Mapping[str, Any] | None = None) -> None:
        """Start a node, again if it has ended, with parameters over those of the graph."""
        self._log(name).touch()  # it may be read before the node has opened it
        self.running[name] = start_node(
            MODULES[name],
            node_arguments(name, self.spec, parameters),
            {**os.environ, 'ROS_DOMAIN_ID': str(self.domain_id)},
            self._log(name).resolve(),
            str(self.spec.out.resolve()),
        )

    def ended(self, name: str) -> bool:
        """Return whether a node has ended."""
        return name in self.running and self.running[name].exitcode is not None

    def check_running(self, *, stopped: bool = False) -> None:
        """Check that no node has ended but a simulator at its end, or as asked; RunError."""
        for name, process in self.running.items():
            code = process.exitcode
            if (
                code is not None
                and (name, code) != (SIM, 0)
                and not (stopped and code in STOPPED)
            ):
                if code in DISK_FULL_ERRORS:
                    raise RunError(
                        f'{name}: {os.strerror(code)}; {self.spec.bag} has what was '
                        'recorded until then'
                    )
                raise RunError(
                    self.report(
                        name,
                        f'ended with exit code {code}'
                        if code >= 0
                        else f'was killed by {signal.Signals(-code).name}',
                    )
                )

    def report(self, name: str, event: str) -> str:
        """Return what happened to a node, with the end of its log."""
        lines = self._text(name).splitlines()[-LOG_LINES:] or ['(nothing)']
        tail = '\n'.join(f'  {line}' for line in lines)
        return f'{name} {event}; the end of {self._log(name)}:\n{tail}'

    def last_line(self, name: str) -> str:
        """Return the last line of a node's log, without time and name."""
        return ''.join(self._text(name).splitlines()[-1:]).rpartition(f'[{name}]: ')[2]

    def new_warnings(self) -> str:
        """Return the last warning or error logged since the last call, and how many there are."""
        warnings = []
        for name in self.running:
            text = self._text(name)
            warnings += WARNING.findall(text, self._seen[name])
            self._seen[name] = text.rfind('\n') + 1
        more = (
            f' (and {len(warnings) - 1} more in {self.spec.logs})'
            if len(warnings) > 1
            else ''
        )
        return shorten(': '.join(warnings[-1]), LINE_LENGTH) + more if warnings else ''

    def _text(self, name: str) -> str:
        return self._log(name).read_text(encoding='utf-8', errors='replace')

    def _log(self, name: str) -> Path:
        return self.spec.logs / f'{name}.log'

    def stop(self, *, hurry: bool = False) -> None:
        """
        Stop what runs, from the source downwards to the recorder.

        With `hurry` no node waits until its messages have arrived.
        """
        for name in (x for x in reversed(START_ORDER) if x in self.running):
            process = self.running[name]
            if process.exitcode is None and process.pid is not None:
                end = signal.SIGTERM if hurry or name == RECORDER else signal.SIGINT
                with contextlib.suppress(
                    ProcessLookupError
                ):  # it has ended this moment
                    os.kill(process.pid, end)
            process.join(RECORDER_TIMEOUT if name == RECORDER else STOP_TIMEOUT)
            process.kill()  # nothing to one that has ended
            process.join()

    def timing(self) -> dict[str, dict[str, Any]]:
        """Return what each node wrote about its run; nothing for one that could not."""
        files = {name: self.spec.logs / f'{name}.json' for name in self.spec.nodes}
        return {
            name: json.loads(file.read_text(encoding='utf-8')) if file.is_file() else {}
            for name, file in files.items()
        }
