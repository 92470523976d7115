"""
Running the graph without a plant of its own: the robot, or its simulator, is behind the topics.

The nodes are configured, then the robot is waited for, for as long as it takes; only when all of
it is there is the controller activated. The run ends after its time, at a signal, when a node
dies or when the robot is silent. Then the controller is deactivated first, so that the robot gets
the declared safe behaviour before it gets nothing. If this process is killed, the controller does
that by itself; nothing can if it is the controller that is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from dataclasses import dataclass
from functools import partial
import time

from multicontact_control.errors import RunError
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.processes import NodeProcesses
from multicontact_control.experiment.graph.progress import GraphProgress, ProgressListener
from multicontact_control.experiment.graph.robot_watch import RobotWatch
from multicontact_control.experiment.graph.run import GraphResult
from multicontact_control.experiment.graph.spec import CONTROLLER, GraphSpec
from multicontact_control.experiment.graph.watching import (
    bring_up,
    collected_signals,
    InterruptedRunError,
    SAMPLES,
    StartSupervision,
    Tell,
    watch,
    WATCH_PERIOD,
)
from multicontact_control.nodes import topics
from multicontact_control.nodes.controller_config import SAFE_TIME
from multicontact_control.nodes.link import (
    ACTIVATE,
    CONFIGURE,
    DEACTIVATE,
    GuestNode,
)

FIRST_TELL = 1.0  # s, before anything is said of what is missing
LONGEST_NAMING = 2.0  # s, that the names of the robot's nodes are waited for
DEACTIVATION_TIMEOUT = 5.0


@dataclass(frozen=True)
class Robot:
    """
    What is expected behind the topics, and for how long.

    Attributes
    ----------
    joint_names
        Joints that it has, among others.
    wrench_input
        Which wrench the controller reads: ``raw`` or ``filtered``; or ``momentum`` for none.
    pair_tolerance
        By how much the stamps of a pair of joints and wrench may differ [s].
    effort_output_topic
        Topic that it may take efforts from instead of ``joint_effort_command``; empty for none.
    timeout
        Time without a message after which it counts as gone [s].
    duration
        Length of the run in the time of its samples [s]; None until a signal comes.

    """

    joint_names: Sequence[str]
    wrench_input: str = 'raw'
    pair_tolerance: float = 0.0
    effort_output_topic: str = ''
    timeout: float = 5.0
    duration: float | None = None


def run_external_graph(
    spec: GraphSpec, robot: Robot,
    on_progress: Callable[[GraphProgress], None] = lambda progress: None,
    on_domain: Callable[[int], None] = lambda domain_id: None, tell: Tell = lambda text: None,
) -> GraphResult:
    """
    Run the graph on a robot that is not this package's.

    SIGINT, SIGTERM and SIGHUP end it cleanly; call it in the main thread for that.

    Parameters
    ----------
    spec
        What to run; `external`.
    robot
        What is behind the topics.
    on_progress
        Called about 5 times a second once samples are answered.
    on_domain
        Called with the ROS domain.
    tell
        Called every few seconds of waiting with what is missing, and with what was found.

    Returns
    -------
    GraphResult
        Where everything is.

    Raises
    ------
    RunError
        If a node cannot be started or dies.

    """
    spec.logs.mkdir(parents=True, exist_ok=True)
    with reserve_domain(spec.domain_id) as domain_id, collected_signals() as interrupted:
        on_domain(domain_id)
        with ProgressListener(domain_id, spec.namespace) as listener, RobotWatch(
                domain_id, spec.namespace, joint_names=robot.joint_names, rate=spec.rate,
                wrench=topics.WRENCHES.get(robot.wrench_input),
                pair_tolerance=robot.pair_tolerance,
                effort_output_topic=robot.effort_output_topic) as watch:
            session = _Session(
                spec, robot, domain_id, interrupted, listener, watch, on_progress, tell)
            ended = session.run()
        if session.activated:
            session.processes.raise_if_failed()
        return GraphResult(
            bag=spec.bag, timing=session.processes.timing(), domain_id=domain_id,
            interrupted=interrupted[0] if interrupted else None, ended=ended,
            controlled=session.controlled)


class _Session:
    """One run, from the start of the nodes to their end."""

    def __init__(
        self, spec: GraphSpec, robot: Robot, domain_id: int, interrupted: list[int],
        listener: ProgressListener, watch: RobotWatch,
        on_progress: Callable[[GraphProgress], None], tell: Tell,
    ) -> None:
        self._spec, self._robot, self._domain_id = spec, robot, domain_id
        self._interrupted, self._listener, self._watch = interrupted, listener, watch
        self._on_progress, self._tell = on_progress, tell
        self.processes = NodeProcesses(spec, domain_id)
        self.activated = self.controlled = False

    def run(self) -> str:
        """Return what ended the run on the side of the robot; empty if nothing did."""
        failed, ended = True, ''
        try:
            self.processes.start_all()
            self._lead(CONFIGURE)
            self._wait_for_robot()
            self.activated = True  # on the way, at least
            self._lead(ACTIVATE)
            ended = watch(self._listener, self._on_progress,
                          partial(self._end, self._supervision()))
            failed = False
        except InterruptedRunError:
            failed = False
        finally:
            if self.activated:
                self._deactivate()
            self.processes.stop(abort=failed)
        return ended

    def _supervision(self, first_tell: float | None = None) -> StartSupervision:
        return StartSupervision(self.processes, self._interrupted, self._tell, first_tell)

    def _lead(self, transition: str) -> None:
        bring_up(self.processes, self._supervision(), self._domain_id, self._spec.namespace,
                 (transition,))

    def _wait_for_robot(self) -> None:
        supervision = self._supervision(FIRST_TELL)
        while missing := self._watch.missing():
            supervision.check()
            supervision.remind(partial(str, missing))
            time.sleep(WATCH_PERIOD)
        named_by = time.monotonic() + LONGEST_NAMING
        while not self._watch.all_named and time.monotonic() < named_by:
            supervision.check()
            time.sleep(WATCH_PERIOD)
        self._tell(f'found {self._watch.found}')

    def _end(self, supervision: StartSupervision, progress: GraphProgress | None) -> str | None:
        """Return what has ended the run, '' for its time; None as long as it goes on."""
        self.controlled = progress is not None
        supervision.check()
        duration = self._robot.duration
        if progress is None:
            supervision.remind(
                lambda: self._watch.doubts() or supervision.describe(SAMPLES))
        elif duration is not None and progress.time >= duration:
            return ''
        return self._watch.silent(self._robot.timeout) or None

    def _deactivate(self) -> None:
        """Let the robot have the safe behaviour, as far as the controller still lives."""
        if CONTROLLER not in self.processes.names or self.processes.ended(CONTROLLER):
            return
        with contextlib.suppress(RunError), GuestNode(
                'run_end', self._domain_id, self._spec.namespace,
                patience=DEACTIVATION_TIMEOUT) as driver:
            driver.change(CONTROLLER, DEACTIVATE)
            time.sleep(SAFE_TIME)
