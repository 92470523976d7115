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

WATCH_PERIOD, PROGRESS_PERIOD = 0.05, 0.2  # s
TELL_PERIOD, WARN_PERIOD = (
    5.0,
    1.0,
)  # s, between two lines on what is waited for, or is wrong
STOPPING = 'stopping the nodes; Ctrl-C again skips the report'
DEACTIVATION_TIMEOUT = 5.0  # s
DISCOVERY_TIME = 1.0  # s, in which the nodes of a domain are known
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Tell = Callable[[str], None]


class InterruptedRunError(Exception):
    """A signal came while a graph was started."""


class GraphProgress(NamedTuple):
    """Where a run is, since the first sample that was seen."""

    time: float  # [s]
    forces: Mapping[str, float]  # measured, per contact [N]
    realtime_factor: float  # simulated time over wall time


@dataclass(frozen=True)
class GraphResult:
    """How a run ended that no node failed in."""

    bag: Path  # folder of the recording, closed
    controlled: bool  # whether any sample was answered
    signals: Sequence[int]  # that ended it early
    timing: Mapping[
        str, Mapping[str, Any]
    ]  # counts and times that each node wrote at its end
    ended: str = ''  # what ended it early on the side of the user's own robot


class ProgressListener(link.ServiceClientNode):
    """Reads the newest measured forces when asked, and takes no time in between."""

    def __init__(self, domain_id: int, namespace: str = '') -> None:
        super().__init__('run_progress', domain_id, namespace)
        self._forces = self.node.create_subscription(
            topics.MEASURED_FORCES.message,
            topics.MEASURED_FORCES.name,
            ignore_message,
            qos.GLANCE,
        )
        self._first = self._start = 0.0
        self.heard = False  # whether anything has come yet

    def newest(self) -> GraphProgress | None:
        """Return what came last since the last call, if anything."""
        taken = take_message(self._forces)
        if taken is None:
            return None
        message, now = taken[0], time.monotonic()
        stamp = 1e-9 * messages.stamp_to_ns(message.header.stamp)
        if not self.heard:
            self.heard, self._first, self._start = True, stamp, now
        simulated, wall = stamp - self._first, now - self._start
        return GraphProgress(
            simulated,
            {
                name: force
                for name, force in zip(message.name, message.effort)
                if math.isfinite(force)
            },
            simulated / wall if wall else 0.0,
        )


class RunningGraph:
    """A graph that is up, of `running_graph`; its `robot` is None with a simulated plant."""

    def __init__(
        self,
        spec: GraphSpec,
        domain_id: int,
        keep_waiting: Callable[[str], None],
    ) -> None:
        self.spec, self.domain_id = spec, domain_id
        self.processes = NodeProcesses(spec, domain_id)
        self.progress = ProgressListener(domain_id, spec.namespace)
        self.robot = (
            None
            if spec.robot is None
            else RobotWatch(domain_id, spec.namespace, spec.robot)
        )
        self._keep_waiting, self._activated = keep_waiting, False

    def start(self) -> None:
        """Start the nodes, wait for the robot, and activate the controller."""
        for name in self.spec.nodes:
            self.processes.start(name)
        self._lead(link.CONFIGURE)
        while self.robot is not None and (missing := self.robot.missing()):
            self._wait(missing)
            time.sleep(WATCH_PERIOD)
        self._activated = True  # on the way, at least
        self._lead(link.ACTIVATE)

    def _wait(self, what: str) -> None:
        self.processes.check_running()
        self._keep_waiting(f'{what}, in ROS domain {self.domain_id}')

    def _lead(self, transition: str) -> None:
        with link.ServiceClientNode(
            'lifecycle_driver',
            self.domain_id,
            self.spec.namespace,
            keep_waiting=self._wait,
        ) as driver:
            for name in MANAGED:
                try:
                    driver.change_state(name, transition)
                except link.TransitionError:
                    raise RunError(
                        self.processes.report(name, f'cannot {transition}')
                    ) from None

    def stop(self, *, hurry: bool) -> None:
        """Stop the nodes, a robot's controller not before its safe behaviour; `hurry` to abort."""
        if (
            self.robot is not None
            and self._activated
            and not self.processes.ended(CONTROLLER)
        ):
            with (
                contextlib.suppress(RunError),
                link.ServiceClientNode(
                    'run_end',
                    self.domain_id,
                    self.spec.namespace,
                    patience=DEACTIVATION_TIMEOUT,
                ) as driver,
            ):
                driver.change_state(CONTROLLER, link.DEACTIVATE)
                time.sleep(SAFE_TIME)
        self.processes.stop(hurry=hurry)
        self.progress.newest()
        for guest in (self.progress, self.robot):
            if guest is not None:
                guest.close()


@contextlib.contextmanager
def running_graph(
    spec: GraphSpec,
    keep_waiting: Callable[[str], None] = lambda what: None,
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
        hurry = True
        try:
            graph.start()
            yield graph
            hurry = False
        finally:
            graph.stop(hurry=hurry)


def _require_free_names(spec: GraphSpec, domain_id: int) -> None:
    """Check that no node of another graph has a name of this one's; RunError."""
    if domain_in_use(domain_id):  # by a driver or a page, too
        with link.ServiceClientNode('run_start', domain_id, spec.namespace) as guest:
            time.sleep(DISCOVERY_TIME)
            known = guest.node.get_node_names_and_namespaces()
        if taken := {(name, f'/{spec.namespace}') for name in spec.nodes} & {*known}:
            raise RunError(
                f'ROS domain {domain_id}: expected no {min(taken)[0]}, got that of another run; '
                'end it, or choose another --domain-id or --namespace'
            )


def run_graph(
    spec: GraphSpec,
    on_progress: Callable[[GraphProgress], None] = lambda progress: None,
    tell: Tell = lambda text: None,
) -> GraphResult:
    """
    Run a graph to its end, or until SIGINT, SIGTERM or SIGHUP; call it in the main thread.

    `on_progress` is called about 5 times a second once samples are answered, `tell` with what is
    waited for, the robot's nodes, commands to try, and at most once a second with what nodes warn
    of. Raises RunError if a node cannot be started or dies, with the end of its log.
    """
    start = time.monotonic()
    due = start + TELL_PERIOD

    def keep_waiting(what: str) -> None:
        nonlocal due
        if signals:
            tell(STOPPING)
            raise InterruptedRunError
        if (now := time.monotonic()) > due:
            due = now + TELL_PERIOD
            tell(f'{now - start:.0f} s: waiting for {what}')

    with collected_signals() as signals:
        try:
            with running_graph(spec, keep_waiting) as graph:
                if graph.robot is not None:
                    tell(f'found {graph.robot.sources}')
                ended = _watch(graph, signals, on_progress, keep_waiting, tell)
                if signals:
                    tell(STOPPING)
        except InterruptedRunError:
            return GraphResult(spec.bag, controlled=False, signals=signals, timing={})
    graph.processes.check_running(stopped=True)
    return GraphResult(
        spec.bag,
        graph.progress.heard or not (signals or ended),
        signals,
        graph.processes.timing(),
        ended,
    )


def _watch(
    graph: RunningGraph,
    signals: list[int],
    on_progress: Callable[[GraphProgress], None],
    keep_waiting: Callable[[str], None],
    tell: Tell,
) -> str:
    """Look at a graph until it ends; return what ended it on the side of the user's robot."""
    processes, robot = graph.processes, graph.spec.robot
    newest: GraphProgress | None = None
    due = warning_due = 0.0
    while not signals and not processes.ended(SIM):
        processes.check_running()
        if time.monotonic() >= warning_due and (text := processes.new_warnings()):
            warning_due = time.monotonic() + WARN_PERIOD
            if (
                not newest
                or not graph.spec.ticks
                or (  # at the end nodes miss each other
                    newest.time + WARN_PERIOD < graph.spec.ticks / graph.spec.rate
                )
            ):
                tell(text)
        if graph.robot is not None and (silent := graph.robot.silent()):
            return silent
        if time.monotonic() >= due:
            due = time.monotonic() + PROGRESS_PERIOD
            if (progress := graph.progress.newest()) is not None:
                if newest is None:
                    tell(_first_steps(graph))
                newest = progress
                on_progress(progress)
            elif (
                newest is None and not signals
            ):  # the controller says why it cannot answer
                keep_waiting(
                    f'the first answered sample; {CONTROLLER}: '
                    f'{processes.last_line(CONTROLLER)}'
                )
        if (
            newest
            and robot
            and robot.duration is not None
            and newest.time >= robot.duration
        ):
            break
        time.sleep(WATCH_PERIOD)
    processes.check_running()
    return ''


def _first_steps(graph: RunningGraph) -> str:
    """Return two commands to try on a graph that answers samples."""
    domain, namespace = graph.domain_id, graph.spec.namespace
    topic = '/'.join(filter(None, (namespace, topics.MEASURED_FORCES.name)))
    of_the_arm = f' --namespace {namespace}' if namespace else ''
    return (
        'ready; try in another terminal:\n'
        f'  multicontact topic echo /{topic} --domain-id {domain}\n'
        f'  multicontact view --graph --domain-id {domain}{of_the_arm}'
    )


@contextlib.contextmanager
def collected_signals() -> Iterator[list[int]]:
    """Collect signals that ask for an end in a list instead of dying of them."""
    received: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(number)
        if number == signal.SIGHUP:  # the terminal is gone, and refuses output
            nowhere = os.open(os.devnull, os.O_WRONLY)
            for stream in (1, 2):
                if not stat.S_ISREG(os.fstat(stream).st_mode):
                    os.dup2(nowhere, stream)

    previous = {
        number: signal.signal(number, note)
        for number in ENDING
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN
    }  # nohup
    try:
        yield received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
