"""
Running a graph: its nodes are started in order, watched, and stopped together.

The end of the simulator ends the run. The user's own robot is waited for before the controller is
activated; the run ends after its time, or when the robot is silent, and the controller is then
deactivated first, so that the robot gets the declared safe behaviour before it gets nothing. If
this process is killed, the controller does that by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass
import math
import os
from pathlib import Path
import signal
import stat
import time
from types import FrameType
from typing import Any, NamedTuple

from multicontact_control.errors import RunError
from multicontact_control.nodes import link, messages, qos, topics
from multicontact_control.nodes.graph import ignore_message, SAFE_TIME, take_message
from multicontact_control.runs.graph.domain import domain_in_use, reserve_domain
from multicontact_control.runs.graph.processes import NodeProcesses
from multicontact_control.runs.graph.robot import RobotWatch
from multicontact_control.runs.graph.spec import (
    CONTROLLER,
    GraphSpec,
    MANAGED,
    SIM,
)

WATCH_PERIOD = 0.05  # s, between two looks at the nodes
PROGRESS_PERIOD = 0.2  # s
TELL_PERIOD = 5.0  # s, between two lines on what is waited for
WARN_PERIOD = 1.0  # s, between two lines on what a node warns of
STOPPING = 'stopping the nodes; Ctrl-C again skips the report'
DEACTIVATION_TIMEOUT = 5.0  # s
DISCOVERY_TIME = 1.0  # s, in which the nodes of a domain are known
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Tell = Callable[[str], None]


class InterruptedRunError(Exception):
    """
    A signal came while a graph was started: there is no run, and no error.

    `keep_waiting` raises it, since a start has no other place at which it looks for signals.
    """


class GraphProgress(NamedTuple):
    """
    Where a run is, since the first sample that was seen, for a progress bar.

    It is read five times a second at most, from the newest message; nothing that is judged depends
    on it.
    """

    time: float  # [s]
    forces: Mapping[str, float]  # measured, per contact [N]
    realtime_factor: float  # simulated time over wall time


@dataclass(frozen=True)
class GraphResult:
    """
    How a run ended that no node failed in, and where its recording is.

    A node that fails is a RunError instead; what was recorded until then stays in the bag.
    """

    bag: Path  # folder of the recording, closed
    controlled: bool  # whether any sample was answered
    signals: Sequence[int]  # that ended it early
    # Counts and times that each node wrote at its end.
    timing: Mapping[str, Mapping[str, Any]]
    ended: str = ''  # what ended it early on the side of the user's own robot


class ProgressListener(link.ServiceClientNode):
    """
    Reads the newest measured forces when asked.

    It takes no time in between: no executor spins it, so that a progress bar costs the control
    loop nothing.
    """

    def __init__(self, domain_id: int, namespace: str = '') -> None:
        super().__init__('run_progress', domain_id, namespace)
        self._forces = self.node.create_subscription(
            topics.MEASURED_FORCES.message,
            topics.MEASURED_FORCES.name,
            ignore_message,
            qos.GLANCE,
        )
        self._first_stamp = 0.0  # of the first message [s], and when it was read
        self._first_read = 0.0
        self.heard = False  # whether any message has come yet

    def read_newest(self) -> GraphProgress | None:
        """
        Return what came last since the last call, None if nothing has come since.

        Time counts from the first message that was read, on the clock of the stamps. Contacts
        whose force is not finite are left out.
        """
        taken = take_message(self._forces)
        if taken is None:
            return None
        message = taken[0]
        stamp = 1e-9 * messages.stamp_to_ns(message.header.stamp)
        now = time.monotonic()
        if not self.heard:
            self.heard = True
            self._first_stamp = stamp
            self._first_read = now
        simulated = stamp - self._first_stamp
        wall = now - self._first_read
        forces = {}
        for name, force in zip(message.name, message.effort):
            if math.isfinite(force):
                forces[name] = force
        return GraphProgress(simulated, forces, simulated / wall if wall else 0.0)


class RunningGraph:
    """
    A graph that is up, of `running_graph`.

    Its `robot` is None with a simulated plant. `keep_waiting` is called with what is waited for.
    """

    def __init__(
        self,
        spec: GraphSpec,
        domain_id: int,
        keep_waiting: Callable[[str], None],
    ) -> None:
        self.spec = spec
        self.domain_id = domain_id
        self.processes = NodeProcesses(spec, domain_id)
        self.progress = ProgressListener(domain_id, spec.namespace)
        self.robot: RobotWatch | None = None
        if spec.robot is not None:
            self.robot = RobotWatch(domain_id, spec.namespace, spec.robot)
        self._keep_waiting = keep_waiting
        self._activated = False

    def start(self) -> None:
        """
        Start the nodes, wait for the robot, and activate estimator and controller.

        Raises RunError, with the end of its log, if a node ends or refuses a transition.
        """
        for name in self.spec.nodes:
            self.processes.start(name)
        self._change_states(link.CONFIGURE)
        if self.robot is not None:
            self._wait_for_robot(self.robot)
        self._activated = True  # on the way, at least
        self._change_states(link.ACTIVATE)

    def _wait_for_robot(self, robot: RobotWatch) -> None:
        while True:
            missing = robot.describe_missing()
            if not missing:
                return
            self._wait_for_node(missing)
            time.sleep(WATCH_PERIOD)

    def _wait_for_node(self, what: str) -> None:
        self.processes.check_running()
        self._keep_waiting(f'{what}, in ROS domain {self.domain_id}')

    def _change_states(self, transition: str) -> None:
        """Lead controller and estimator through a transition; RunError if one refuses."""
        with link.ServiceClientNode(
            'lifecycle_driver',
            self.domain_id,
            self.spec.namespace,
            keep_waiting=self._wait_for_node,
        ) as driver:
            for name in MANAGED:
                try:
                    driver.change_state(name, transition)
                except link.TransitionError:
                    event = f'cannot {transition}'
                    raise RunError(self.processes.describe_end(name, event)) from None

    def stop(self, *, abort: bool) -> None:
        """
        Stop the nodes, a robot's controller not before its safe behaviour.

        With `abort` no node waits until its messages have arrived.
        """
        controlling = self._activated and not self.processes.has_ended(CONTROLLER)
        if self.robot is not None and controlling:
            with contextlib.suppress(RunError):
                self._deactivate_controller()
        self.processes.stop(abort=abort)
        self.progress.read_newest()
        self.progress.close()
        if self.robot is not None:
            self.robot.close()

    def _deactivate_controller(self) -> None:
        with link.ServiceClientNode(
            'run_end',
            self.domain_id,
            self.spec.namespace,
            patience=DEACTIVATION_TIMEOUT,
        ) as driver:
            driver.change_state(CONTROLLER, link.DEACTIVATE)
            time.sleep(SAFE_TIME)


@contextlib.contextmanager
def running_graph(
    spec: GraphSpec, keep_waiting: Callable[[str], None]
) -> Iterator[RunningGraph]:
    """
    Start a graph and activate it, yield it, and stop it afterwards.

    Start it in the main thread. `keep_waiting` is called many times a second during the start with
    what is waited for, and may raise. Raises RunError if a node cannot be started, with the end of
    its log, or if another graph has its names.
    """
    with reserve_domain(spec.domain_id) as domain_id:
        _require_free_names(spec, domain_id)
        graph = RunningGraph(spec, domain_id, keep_waiting)
        abort = True
        try:
            graph.start()
            yield graph
            abort = False
        finally:
            graph.stop(abort=abort)


def _require_free_names(spec: GraphSpec, domain_id: int) -> None:
    """Check that no node of another graph has a name of this one's; RunError."""
    if not domain_in_use(domain_id):  # by a driver or a page, too
        return
    with link.ServiceClientNode('run_start', domain_id, spec.namespace) as guest:
        time.sleep(DISCOVERY_TIME)
        known = guest.node.get_node_names_and_namespaces()
    for name in sorted(spec.nodes):
        if (name, f'/{spec.namespace}') in known:
            raise RunError(
                f'ROS domain {domain_id}: expected no {name}, got that of another run; '
                'end it, or choose another --domain-id or --namespace'
            )


class _RunMonitor:
    """
    What a user is told of a run, and when.

    `signals` are those that have come; `on_progress` and `tell` are those of `run_graph`.
    """

    def __init__(
        self,
        signals: Sequence[int],
        on_progress: Callable[[GraphProgress], None],
        tell: Tell,
    ) -> None:
        self._signals = signals
        self._on_progress = on_progress
        self._tell = tell
        self._start = time.monotonic()
        # When the next line, warning and progress are due, on the monotonic clock [s].
        self._line_due = self._start + TELL_PERIOD
        self._warning_due = 0.0
        self._progress_due = 0.0
        self.simulated: float | None = None  # time since the first answer [s]

    def keep_waiting(self, what: str) -> None:
        """
        Tell what is waited for, every 5 s; InterruptedRunError after a signal.

        It is called many times a second during a start.
        """
        if self._signals:
            self._tell(STOPPING)
            raise InterruptedRunError
        now = time.monotonic()
        if now > self._line_due:
            self._line_due = now + TELL_PERIOD
            self._tell(f'{now - self._start:.0f} s: waiting for {what}')

    def pass_warnings(self, graph: RunningGraph) -> None:
        """Tell what nodes warn of; at the end of a run they miss each other, which is no news."""
        if time.monotonic() < self._warning_due:
            return
        text = graph.processes.new_warnings()
        if not text:
            return
        self._warning_due = time.monotonic() + WARN_PERIOD
        duration = graph.spec.ticks / graph.spec.rate  # 0 for a run without an end
        simulated = self.simulated
        near_end = simulated is not None and simulated + WARN_PERIOD >= duration > 0.0
        if not near_end:
            self._tell(text)

    def pass_progress(self, graph: RunningGraph) -> None:
        """Show how far the run is, or tell why the controller cannot answer yet."""
        now = time.monotonic()
        if now < self._progress_due:
            return
        self._progress_due = now + PROGRESS_PERIOD
        progress = graph.progress.read_newest()
        if progress is not None:
            if self.simulated is None:
                self._tell(_suggest_first_steps(graph))
            self.simulated = progress.time
            self._on_progress(progress)
        elif self.simulated is None and not self._signals:
            self.keep_waiting(
                f'the first answered sample; {CONTROLLER}: '
                f'{graph.processes.last_line(CONTROLLER)}'
            )


def run_graph(
    spec: GraphSpec,
    on_progress: Callable[[GraphProgress], None] = lambda progress: None,
    tell: Tell = lambda text: None,
) -> GraphResult:
    """
    Run a graph to its end, or until SIGINT, SIGTERM or SIGHUP; call it in the main thread.

    Parameters
    ----------
    spec
        What to run.
    on_progress
        Called about 5 times a second once samples are answered.
    tell
        Called with what is waited for, the robot's nodes, commands to try, and at most once a
        second with what nodes warn of.

    Raises
    ------
    RunError
        If a node cannot be started or dies, with the end of its log.

    """
    with collected_signals() as signals:
        monitor = _RunMonitor(signals, on_progress, tell)
        try:
            with running_graph(spec, monitor.keep_waiting) as graph:
                if graph.robot is not None:
                    tell(f'found {graph.robot.sources}')
                ended = _watch_graph(graph, signals, monitor)
                if signals:
                    tell(STOPPING)
        except InterruptedRunError:
            return GraphResult(spec.bag, controlled=False, signals=signals, timing={})
    graph.processes.check_running(stopped=True)
    ended_early = bool(signals or ended)
    return GraphResult(
        spec.bag,
        controlled=graph.progress.heard or not ended_early,
        signals=signals,
        timing=graph.processes.read_timing(),
        ended=ended,
    )


def _watch_graph(
    graph: RunningGraph, signals: Sequence[int], monitor: _RunMonitor
) -> str:
    """Look at a graph until it ends; return what ended it on the side of the user's robot."""
    duration = math.inf
    if graph.spec.robot is not None and graph.spec.robot.duration is not None:
        duration = graph.spec.robot.duration
    while not signals and not graph.processes.has_ended(SIM):
        graph.processes.check_running()
        monitor.pass_warnings(graph)
        if graph.robot is not None:
            silent = graph.robot.describe_silence()
            if silent:
                return silent
        monitor.pass_progress(graph)
        if monitor.simulated is not None and monitor.simulated >= duration:
            break
        time.sleep(WATCH_PERIOD)
    graph.processes.check_running()
    return ''


def _suggest_first_steps(graph: RunningGraph) -> str:
    """Return two commands to try on a graph that answers samples."""
    where = f'--domain-id {graph.domain_id}'
    topic = f'/{topics.MEASURED_FORCES.name}'
    of_graph = where
    if graph.spec.namespace:
        topic = f'/{graph.spec.namespace}{topic}'
        of_graph = f'{where} --namespace {graph.spec.namespace}'
    return (
        'ready; try in another terminal:\n'
        f'  multicontact topic echo {topic} {where}\n'
        f'  multicontact view --graph {of_graph}'
    )


@contextlib.contextmanager
def collected_signals() -> Iterator[list[int]]:
    """
    Collect SIGINT, SIGTERM and SIGHUP in a list instead of dying of them.

    The list is yielded, and grows while the context lasts. A SIGHUP also means that the terminal
    has gone; under nohup it is ignored.
    """
    received: list[int] = []

    def note_signal(number: int, _frame: FrameType | None) -> None:
        received.append(number)
        if number == signal.SIGHUP:
            _silence_terminal()

    previous = {}
    for number in ENDING:
        ignored = signal.getsignal(number) == signal.SIG_IGN  # SIGHUP, by nohup
        if number != signal.SIGHUP or not ignored:
            previous[number] = signal.signal(number, note_signal)
    try:
        yield received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _silence_terminal() -> None:
    """Send what goes to the terminal nowhere: it has gone, and refuses output; files stay."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        if not stat.S_ISREG(os.fstat(stream).st_mode):
            os.dup2(nowhere, stream)
