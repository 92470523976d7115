"""A running graph that faults are put into, and that is brought back to a good state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import contextlib
import math
from pathlib import Path
import signal
import time
from types import TracebackType
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.experiment.faults.fault import Command, Fault, NodeChange, Random
from multicontact_control.experiment.faults.graph_operator import Operator
from multicontact_control.experiment.faults.graph_relay import (
    INPUTS,
    outgoing,
    PARAMETER,
    RELAY,
)
from multicontact_control.experiment.faults.graph_watch import GraphWatch
from multicontact_control.experiment.faults.vocabulary import HALT, KILL
from multicontact_control.experiment.graph.processes import NodeProcesses
from multicontact_control.experiment.graph.spec import (
    CONTROLLER,
    ESTIMATOR,
    GraphSpec,
    MANAGED,
    RECORDER,
    SIM,
)
from multicontact_control.experiment.scenario import Setup
from multicontact_control.nodes import topics
from multicontact_control.nodes.link import (
    ACTIVATE,
    CONFIGURE,
    GuestNode,
    LifecycleDriver,
    NoAnswerError,
)
from multicontact_control.supervision.command_limits import CommandLimits
import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher

END_TIME = 1.0  # s, after a motion command that nothing follows
NEAR = 0.01  # m
HALT_TIME = (0.02, 0.2)  # s
OUTAGE = (0.0, 0.5)  # s, from the end of a process to its successor's start
FAULT_TIME = (0.1, 0.4)  # s
POLL_PERIOD = 0.005  # s
CHECK_PERIOD = 0.1
WANTED_FORCE = 10.0  # N, at every contact
FORCE_TOLERANCE = 0.25  # of that
SETTLE_TIME = 0.2  # s, over which the force is averaged
RECOVERY_TIMEOUT = 90.0  # s; on a busy machine late samples hold the arm again and again
STATE_TIMEOUT = 90.0  # s, for a node that has just been started
ATTEMPTS = 3  # at making contact within that time
RECORDED = (topics.JOINT_STATES, topics.WRENCH, topics.TRUE_FORCES, topics.EFFORT_COMMAND,
            topics.NOISE_VARIANCE, topics.DIAGNOSTICS)


# A machine without real-time priority has hiccups of many periods; they are not the faults that
# are to be answered here. In process the limits are the default ones, of few periods.
PATIENT: Mapping[str, float] = {
    'patience': 10.0, 'watchdog.joint_max_age': 15.0, 'watchdog.wrench_max_age': 15.0,
    'watchdog.variance_max_age': 25.0, 'watchdog.rate_band': 25.0}


class NotRecoveredError(RunError):
    """The graph did not come back to a good state."""


def fault_graph(setup: Setup, folder: Path, domain_id: int) -> GraphSpec:
    """Return the graph of a campaign, with the relay in it, its configuration written."""
    config = folder / 'config'
    setup.write(config)
    nobody: dict[str, Any] = {'startup_peers': []}  # whoever starts again waits for nobody
    return GraphSpec(
        out=folder, ticks=0, rate=setup.controller.rate, seed=setup.seed, domain_id=domain_id,
        parameter_files={CONTROLLER: config / 'controller.yaml', SIM: config / 'plant.yaml',
                         ESTIMATOR: config / 'noise_estimator.yaml'},
        extra_nodes={RELAY: 'multicontact_control.experiment.faults.graph_relay'},
        remappings={CONTROLLER: {x.name: outgoing(x.name) for x in INPUTS.values()}},
        extra_parameters={
            CONTROLLER: {**nobody, **PATIENT}, ESTIMATOR: nobody, SIM: nobody, RELAY: nobody,
            RECORDER: nobody | {'topics': [topic.name for topic in RECORDED]}})


class FaultSession:
    """
    One graph, started, with somebody who commands it and somebody who listens.

    Parameters
    ----------
    setup
        Plant, controller, estimator.
    folder
        Where the bag and the logs go.
    domain_id
        ROS domain.
    keep_waiting
        Called often; may raise to give up.

    """

    def __init__(
        self, setup: Setup, folder: Path, domain_id: int,
        keep_waiting: Callable[[], None] = lambda: None,
    ) -> None:
        self.setup, self._keep_waiting = setup, keep_waiting
        self.spec = fault_graph(setup, folder, domain_id)
        self.spec.logs.mkdir(parents=True, exist_ok=True)
        self.processes = NodeProcesses(self.spec, domain_id)
        self._guest = GuestNode('fault_campaign', domain_id)
        self.node = self._guest.node
        self.watch = GraphWatch(self.node)
        names = setup.controller.contact_names
        self.wanted = dict.fromkeys(names, WANTED_FORCE)
        self.operator = Operator(self.node, self.watch, self.wanted)
        self.driver = LifecycleDriver(
            domain_id, lambda what: self._poll_all(), poll_period=4.0 * POLL_PERIOD)
        self._next_check = 0.0
        self._recordings = 0

    def __enter__(self) -> FaultSession:
        try:
            self.processes.start_all()
            self.recover()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None,
        _trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop what was not ended by `end_all`: then something failed, and nothing more counts."""
        self.processes.stop(abort=True)
        self.driver.close()
        self._guest.close()

    def spin(self, duration: float) -> None:
        """
        Let the graph run for a time [s].

        Raises
        ------
        RunError
            If a node has died.

        """
        end = time.monotonic() + duration
        while (remaining := end - time.monotonic()) > 0.0:
            self._poll_all()
            time.sleep(min(POLL_PERIOD, remaining))

    def wait(
        self, condition: Callable[[], object], what: str, timeout: float = RECOVERY_TIMEOUT,
    ) -> None:
        """
        Wait for something, `timeout` [s] at most.

        Raises
        ------
        NotRecoveredError
            If it does not happen.

        """
        give_up = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > give_up:
                raise NotRecoveredError(f'{what}: not within {timeout:g} s')
            self.spin(POLL_PERIOD)

    def _poll_all(self) -> None:
        self._keep_waiting()
        self.watch.poll()
        self.operator.poll()
        if time.monotonic() >= self._next_check:
            self._next_check = time.monotonic() + CHECK_PERIOD
            self.processes.raise_if_ended()

    def inject(self, fault: Fault, random: Random, seed: int) -> None:
        """Let a fault happen; what a node was led down from is left to `recover`."""
        action = fault.action
        if not isinstance(action, NodeChange):
            duration = float(random.uniform(*FAULT_TIME))
            if isinstance(action, Command):
                self._command(fault, action, duration)
            else:
                self._distort(f'{fault.input} {fault.kind} {seed}')
                self.spin(duration)
                self._distort('')
        elif action.steps == KILL:
            self._restart(fault.input, float(random.uniform(*OUTAGE)))
        elif action.steps == HALT:
            self._halt(fault.input, float(random.uniform(*HALT_TIME)))
        else:
            self._lead(fault.input, action.steps)
            self.spin(float(random.uniform(*FAULT_TIME)))

    def _command(self, fault: Fault, command: Command, duration: float) -> None:
        """Publish a command, and see what comes of it for a time [s]."""
        publisher, message = self.operator.draft(fault.input.split()[0])
        command.change(message)
        if command.last:
            self._end_motion(publisher, message)
            return
        end = time.monotonic() + duration
        while time.monotonic() < end:
            publisher.publish(message)
            self.spin(POLL_PERIOD)

    def _end_motion(self, publisher: Publisher, message: Any) -> None:
        """
        Publish a motion command as the last for a while.

        Raises
        ------
        RunError
            If it leads further than it can while its twist counts.

        """
        self.operator.stop()
        before = self.watch.pose.pose.position
        publisher.publish(message)
        self.spin(END_TIME)
        after = self.watch.pose.pose.position
        way = math.dist((before.x, before.y, before.z), (after.x, after.y, after.z))
        fastest = self.setup.controller.limits.operational_speed
        if not way < fastest * CommandLimits().motion_timeout + NEAR:
            raise RunError(f'led on for {way:.2f} m after the last motion command')

    def _distort(self, text: str) -> None:
        """Let the relay do something to an input, or pass everything on as it is."""
        request = SetParameters.Request(
            parameters=[Parameter(PARAMETER, value=text).to_parameter_msg()])
        answer = self.driver.call(RELAY, SetParameters, 'set_parameters', request)
        if answer is None or not answer.results[0].successful:
            raise RunError(f'{RELAY} did not take {text!r}')

    def _halt(self, name: str, duration: float) -> None:
        """Halt a process for a time [s]."""
        self.processes.signal(name, signal.SIGSTOP)
        try:
            self.spin(duration)
        finally:
            self.processes.signal(name, signal.SIGCONT)

    def _restart(self, name: str, outage: float) -> None:
        """Kill a node and start it again after a time [s]."""
        self.processes.kill(name)
        if name == CONTROLLER:
            self.operator.stop()
        self.spin(outage)
        parameters = {}
        if name == RECORDER:  # what the killed one left is not overwritten
            self._recordings += 1
            parameters['folder'] = str((self.spec.out / f'bag_{self._recordings}').resolve())
        self.processes.start(name, parameters)

    def _lead(self, name: str, transitions: tuple[str, ...]) -> None:
        """Lead a managed node through transitions."""
        if name == CONTROLLER:
            self.operator.stop()
        for transition in transitions:
            self.driver.change(name, transition)

    def recover(self) -> None:
        """
        Bring the graph back to where both contacts have their force.

        Raises
        ------
        NotRecoveredError
            If that cannot be done.

        """
        self._distort('')
        for name in MANAGED:
            state = self._state(name)
            if state == 'unconfigured':
                self.driver.change(name, CONFIGURE)
            if state != 'active':
                self.driver.change(name, ACTIVATE)
        start = time.time()
        self.watch.pose = None
        self.wait(lambda: self.watch.since(topics.EFFORT_COMMAND, start), 'commands')
        self.wait(lambda: self.watch.since(topics.NOISE_VARIANCE, start), 'noise variances')
        for attempt in range(ATTEMPTS):
            self.wait(self.operator.start, 'a controller that obeys')
            try:
                self.wait(self._in_contact, 'back in contact', RECOVERY_TIMEOUT / ATTEMPTS)
                return
            except NotRecoveredError:
                if attempt == ATTEMPTS - 1:
                    raise
            # A contact that was given up is only looked for again once it was not wanted.
            self.operator.let_go()
            self.spin(SETTLE_TIME)

    def wait_for_report(self, since: float, timeout: float) -> None:
        """Wait for diagnostics of the controller from after a time, `timeout` [s] at most."""
        with contextlib.suppress(NotRecoveredError):
            self.wait(lambda: any(report.node == CONTROLLER and report.time >= since
                                  for report in self.watch.reports), 'a report', timeout)

    def _state(self, name: str) -> str:
        """Return the state of a node that may have just been started."""
        try:
            return self.driver.state(name, STATE_TIMEOUT)
        except NoAnswerError as error:
            raise NotRecoveredError(f'{error} within {STATE_TIMEOUT:g} s') from None

    def _in_contact(self) -> bool:
        """Return whether every true force has been near its command for a while."""
        said = self.watch.since(topics.TRUE_FORCES, time.time() - SETTLE_TIME)
        if len(said) < 0.3 * SETTLE_TIME * self.spec.rate:
            return False
        forces = np.array([[x.values[name] for name in self.wanted] for x in said])
        wanted = np.array(list(self.wanted.values()))
        return bool((forces > 0.0).all() and (
            np.abs(forces.mean(axis=0) - wanted) <= FORCE_TOLERANCE * wanted).all())

    def end_all(self) -> list[str]:
        """End every node as at the end of a run; return who did not end cleanly."""
        self.operator.stop()
        codes = {name: self.processes.end(name) for name in (
            SIM, RELAY, CONTROLLER, ESTIMATOR, RECORDER)}
        return [f'{name} ended with {code}' for name, code in codes.items() if code]
