"""
Running the ROS 2 graph: plain processes, started in order, watched, and stopped together.

The controller and the estimator are configured and activated from here; the others have nothing
to configure. The end of the simulator ends the run. The others are then stopped from the source
downwards, the recorder last, so that every message that was sent is in the bag when it closes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import contextlib
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time
from types import FrameType
from typing import Any, IO

from multicontact_control.errors import RunError
from multicontact_control.experiment.domain import reserve_domain
from multicontact_control.experiment.lifecycle import (
    ACTIVATE,
    CONFIGURE,
    LifecycleDriver,
    TransitionError,
)
from multicontact_control.experiment.progress import GraphProgress, ProgressListener
from multicontact_control.nodes.runtime import FOLLOW_PARENT
from multicontact_control.process import THREAD_VARIABLES

RECORDER, ESTIMATOR = 'recorder_node', 'noise_estimator_node'
CONTROLLER, SIM = 'controller_node', 'sim_node'
START_ORDER = (RECORDER, ESTIMATOR, CONTROLLER, SIM)
MANAGED = (ESTIMATOR, CONTROLLER)  # in the order in which they are activated
STOP_ORDER = (SIM, CONTROLLER, ESTIMATOR, RECORDER)
MODULES = {
    RECORDER: 'multicontact_control.nodes.recorder_node',
    ESTIMATOR: 'multicontact_control.nodes.noise_estimator_node',
    CONTROLLER: 'multicontact_control.nodes.controller_node',
    SIM: 'sim_bridge.sim_node'}

WATCH_PERIOD = 0.05
PROGRESS_PERIOD = 0.2
STOP_TIMEOUTS = ((signal.SIGINT, 6.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 2.0))
LOG_LINES = 12


@dataclass(frozen=True)
class GraphSpec:
    """
    What to run.

    Attributes
    ----------
    out
        Folder of the run; must exist.
    parameter_files
        Parameter file per node name; a node without one gets its defaults.
    ticks
        Samples until the run ends, 0 for a signal to end it.
    rate
        Control rate [Hz].
    lockstep
        Whether the nodes wait for each other instead of the wall clock.
    seed
        Seed of the plant.
    reference_file
        Scenario for the controller; none lets it obey the command topics.
    domain_id
        ROS domain; by default that of the environment, else one that is free.
    namespace
        Namespace of all nodes, topics and services, without a leading slash; empty for none.
    extra_parameters
        More parameters per node name, over those of its file.

    """

    out: Path
    parameter_files: Mapping[str, Path]
    ticks: int
    rate: float
    lockstep: bool = False
    seed: int = 0
    reference_file: Path | None = None
    domain_id: int | None = None
    namespace: str = ''
    extra_parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def bag(self) -> Path:
        """Folder of the recording."""
        return self.out / 'bag'

    @property
    def logs(self) -> Path:
        """Folder of the nodes' logs and counts."""
        return self.out / 'logs'


@dataclass(frozen=True)
class GraphResult:
    """
    How a run ended that no node failed in.

    Attributes
    ----------
    bag
        Folder of the recording, closed.
    timing
        Counts and times that each node wrote at its end, by node name.
    domain_id
        ROS domain it ran in.
    interrupted
        Signal that ended it early, None if it ran to its end.

    """

    bag: Path
    timing: Mapping[str, Mapping[str, Any]]
    domain_id: int
    interrupted: int | None


def run_graph(
    spec: GraphSpec, on_progress: Callable[[GraphProgress], None] | None = None,
) -> GraphResult:
    """
    Run the graph to its end.

    SIGINT and SIGTERM end it early and cleanly; call it in the main thread for that.

    Parameters
    ----------
    spec
        What to run.
    on_progress
        Called about 5 times a second once samples flow.

    Returns
    -------
    GraphResult
        Where everything is.

    Raises
    ------
    RunError
        If a node cannot be started or dies: its name, how it ended and the end of its log.

    """
    spec.logs.mkdir(parents=True, exist_ok=True)
    with reserve_domain(spec.domain_id) as domain_id, _signals() as interrupted:
        processes = _Processes(spec, _environment(spec, domain_id))
        listener = ProgressListener(domain_id, spec.namespace) if (
            on_progress is not None) else None
        try:
            processes.start()
            _bring_up(processes, interrupted, domain_id, spec.namespace)
            _watch(processes, interrupted, listener, on_progress)
        finally:
            if listener is not None:
                listener.close()
            processes.stop()
        if not interrupted:
            processes.raise_if_failed()
        return GraphResult(
            bag=spec.bag, timing=processes.timing(), domain_id=domain_id,
            interrupted=interrupted[0] if interrupted else None)


class _InterruptedError(Exception):
    """A signal came before the graph was up."""


def _bring_up(
    processes: _Processes, interrupted: list[int], domain_id: int, namespace: str,
) -> None:
    """Configure and activate the managed nodes."""
    def keep_waiting() -> None:
        processes.raise_if_failed()
        processes.raise_if_gone()
        if interrupted:
            raise _InterruptedError

    with contextlib.suppress(_InterruptedError), LifecycleDriver(
            domain_id, keep_waiting, namespace) as driver:
        for transition in (CONFIGURE, ACTIVATE):
            for name in MANAGED:
                try:
                    driver.change(name, transition)
                except TransitionError:
                    raise RunError(
                        processes.obituary(name, f'cannot {transition}')) from None


def _watch(
    processes: _Processes, interrupted: list[int], listener: ProgressListener | None,
    on_progress: Callable[[GraphProgress], None] | None,
) -> None:
    """Wait until the simulator has ended or a signal has come."""
    next_progress = 0.0
    while not interrupted:
        processes.raise_if_failed()
        processes.raise_if_gone()
        if processes.ended(SIM):
            return
        if listener is not None and on_progress is not None and (
                time.monotonic() >= next_progress):
            next_progress = time.monotonic() + PROGRESS_PERIOD
            progress = listener.newest()
            if progress is not None:
                on_progress(progress)
        time.sleep(WATCH_PERIOD)


class _Processes:
    """The processes of the graph."""

    def __init__(self, spec: GraphSpec, environment: Mapping[str, str]) -> None:
        self._spec = spec
        self._environment = environment
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._logs: dict[str, IO[bytes]] = {}

    def start(self) -> None:
        for name in START_ORDER:
            log = (self._spec.logs / f'{name}.log').open('wb')
            self._logs[name] = log
            try:
                # In a session of its own a node does not get the terminal's Ctrl-C: it is
                # stopped here, in order.
                self._running[name] = subprocess.Popen(
                    node_command(name, self._spec), stdin=subprocess.DEVNULL, stdout=log,
                    stderr=subprocess.STDOUT, env=dict(self._environment),
                    start_new_session=True)
            except OSError as error:
                raise RunError(f'{name}: cannot be started: {error}') from None

    def ended(self, name: str) -> bool:
        return self._running[name].poll() is not None

    def raise_if_failed(self) -> None:
        """Raise if a node has ended other than with 0."""
        for name, process in self._running.items():
            code = process.poll()
            if code:
                raise RunError(self.obituary(name, _how(code)))

    def raise_if_gone(self) -> None:
        """Raise if a node has ended although the simulator has not, and nobody asked it to."""
        for name, process in self._running.items():
            code = process.poll()
            if code is not None and not self.ended(SIM):
                raise RunError(self.obituary(name, _how(code)))

    def obituary(self, name: str, how: str) -> str:
        """Return what happened to a node, with the end of its log."""
        path = self._spec.logs / f'{name}.log'
        lines = path.read_text(encoding='utf-8', errors='replace').splitlines()[-LOG_LINES:]
        tail = '\n'.join(f'  {line}' for line in lines) or '  (nothing)'
        return f'{name} {how}; the end of {path}:\n{tail}'

    def stop(self) -> None:
        """Stop what still runs, one after the other, the recorder last."""
        for name in STOP_ORDER:
            process = self._running.get(name)
            if process is not None:
                self._stop_one(process)
        for log in self._logs.values():
            log.close()

    @staticmethod
    def _stop_one(process: subprocess.Popen[bytes]) -> None:
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


def _how(code: int) -> str:
    return f'was killed by {signal.Signals(-code).name}' if code < 0 else (
        f'ended with exit code {code}')


def timing_file(spec: GraphSpec, name: str) -> Path:
    """Return where a node writes its counts and times."""
    return spec.logs / f'{name}.json'


def node_command(name: str, spec: GraphSpec) -> list[str]:
    """Return the command line of a node: its installed script, or its module."""
    script = Path(sys.executable).parent / name
    command = [str(script)] if os.access(script, os.X_OK) else (
        [sys.executable, '-m', MODULES[name]])
    command.append('--ros-args')
    if spec.namespace:
        command += ['-r', f'__ns:=/{spec.namespace}']
    parameter_file = spec.parameter_files.get(name)
    if parameter_file is not None:
        command += ['--params-file', str(parameter_file.resolve())]
    for key, value in node_parameters(name, spec).items():
        command += ['-p', f'{key}:={_as_argument(value)}']
    return command


def node_parameters(name: str, spec: GraphSpec) -> dict[str, Any]:
    """Return the parameters that belong to the run, not to a file."""
    values: dict[str, Any] = {
        'timing_file': str(timing_file(spec, name).resolve()), 'startup_peers': list(START_ORDER)}
    if name == RECORDER:
        values['folder'] = str(spec.bag.resolve())
    if name == SIM:
        values |= {'ticks': spec.ticks, 'rate': float(spec.rate), 'seed': spec.seed}
    if name == CONTROLLER and spec.reference_file is not None:
        values['reference_file'] = str(spec.reference_file.resolve())
    if name in (SIM, CONTROLLER):
        values['lockstep'] = spec.lockstep
    if name in MANAGED:
        values['use_sim_time'] = spec.lockstep
    return {**values, **spec.extra_parameters.get(name, {})}


def _as_argument(value: Any) -> str:
    """Return a value as YAML on one line; JSON is that, and keeps 500.0 a double."""
    return json.dumps(value)


def _environment(spec: GraphSpec, domain_id: int) -> dict[str, str]:
    environment = dict(os.environ)
    for variable in THREAD_VARIABLES:
        environment.setdefault(variable, '1')
    environment.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    environment.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    environment['ROS_DOMAIN_ID'] = str(domain_id)
    environment['ROS_LOG_DIR'] = str((spec.logs / 'ros').resolve())
    environment['PYTHONUNBUFFERED'] = '1'
    environment[FOLLOW_PARENT] = str(os.getpid())
    root = Path(__file__).resolve().parents[2]
    if (root / 'package.xml').is_file():
        # A checkout that is run without being installed.
        paths = [str(root), *filter(None, environment.get('PYTHONPATH', '').split(os.pathsep))]
        environment['PYTHONPATH'] = os.pathsep.join(paths)
    return environment


@contextlib.contextmanager
def _signals() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM in a list instead of dying of them."""
    received: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(number)

    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    previous = {x: signal.signal(x, note) for x in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
