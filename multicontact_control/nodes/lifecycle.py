"""A node with a life cycle, as `rclpy.lifecycle` has it, in the manner of this graph."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
import gc
import sys
import time
import traceback
from typing import Any

from multicontact_control.config import Config
from multicontact_control.errors import MulticontactError
from multicontact_control.nodes.background import BackgroundThread
from multicontact_control.nodes.diagnostics import ComponentStatus, DiagnosticsPublisher
from multicontact_control.nodes.graph import RefusalLog, StartupConfig, StartupGate
from multicontact_control.nodes.live_changes import LiveChanges
from multicontact_control.nodes.parameters import ParameterSet
from multicontact_control.nodes.private import change_state_service, RCLError
from multicontact_control.nodes.runtime import AUTOSTART, Spinner
from multicontact_control.process import settle_process
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = (
    'unconfigured',
    'inactive',
    'active',
    'finalized',
)
SPIN_TIMEOUT = 0.02  # s, between two looks at the gate and at what is due
DRAIN_TIME = 0.1  # s, at the end, for callbacks of what has arrived or is on its way
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ManagedNode(LifecycleNode):
    """
    What the managed nodes of the graph share: transitions, parameters, gate, diagnostics.

    A transition that fails says why in one line and leaves the node where it was. rclpy calls
    callbacks in every state: they look at `state`. A node is `working` once it is active and its
    peers are there. `look` is called at `due` at the latest, monotonic time [ns]; 0 for now and
    then. What takes longer than a sample may wait is for the `background`.
    """

    def __init__(self, name: str, *models: type[Config], **options: Any) -> None:
        super().__init__(name, **options)
        self.state, self.working, self.due = UNCONFIGURED, False, 0
        self.refusals = RefusalLog(self.get_logger())
        self.parameter_set = ParameterSet(self, *models)
        self.parameter_set.report_refusal = self.refusals.log_refusal
        self.parameter_set.compute_design = self.compute_design
        self.background = BackgroundThread()
        self._changes = LiveChanges(self, self.parameter_set, self.background)
        self._diagnostics = DiagnosticsPublisher(
            self, self._all_statuses, self.background
        )
        self._gate: StartupGate | None = None
        self._gate_passed, self._failure = (
            False,
            MulticontactError('the node cannot be started'),
        )
        service = change_state_service(self)
        service.callback = partial(self._change_if_possible, service.callback)
        self._lasting: list[Any] = [
            *self.publishers,
            *self.subscriptions,
            *self.services,
        ]

    @abstractmethod
    def configure(self, configurations: Sequence[Any]) -> None:
        """Load everything and create the ends of topics; may raise `MulticontactError`."""

    @abstractmethod
    def activate(self) -> StartupConfig:
        """Forget the past and begin; return what to wait for."""

    @abstractmethod
    def write_run_counts(self) -> None:
        """Write the counts of the run; the ends of topics are destroyed by themselves."""

    @abstractmethod
    def collect_statuses(self) -> Iterable[ComponentStatus | None]:
        """Yield what diagnostics report, and None where a sample may come between."""

    def deactivate(self) -> None:
        """Stop the node's work; by itself it gives no more answers."""

    def compute_design(self, configurations: Sequence[Any]) -> Any:
        """Return what new configurations lead to, or raise; called in another thread."""
        return configurations

    def apply_design(self, design: Any) -> None:
        """Go on with what new configurations lead to, or raise and change nothing."""

    def do_due_work(self, spinner: Spinner) -> None:
        """Do what is due; called after each callback, at `due`, and when the gate has opened."""

    def shutdown_safely(self, spinner: Spinner) -> None:
        """Do what others need before the process ends; called when it has been asked to."""

    def run(self, spinner: Spinner) -> None:
        """Run callbacks until asked to stop or shut down; raise if an autostart fails."""
        if AUTOSTART in sys.argv:
            for trigger in (self.trigger_configure, self.trigger_activate):
                if trigger() != SUCCESS:
                    raise self._failure
        while not (spinner.stop or self.state == FINALIZED):
            self.spin_once(spinner)
        self.shutdown_safely(spinner)
        end = time.monotonic() + DRAIN_TIME
        while time.monotonic() < end:
            spinner.spin_once(SPIN_TIMEOUT)

    def spin_once(self, spinner: Spinner) -> None:
        """Run what comes next, and what is due between two callbacks."""
        left = (self.due - time.monotonic_ns()) * 1e-9 if self.due else SPIN_TIMEOUT
        spinner.spin_once(min(SPIN_TIMEOUT, max(0.0, left)))
        if self.state == ACTIVE and not self.working and self._gate is not None:
            self.working = self._gate_passed = self._gate.poll()
        if self.working or self.state == INACTIVE:
            self.do_due_work(spinner)
        self._changes.poll()
        self._diagnostics.poll()

    def _all_statuses(self) -> Iterator[ComponentStatus | None]:
        yield ComponentStatus('life cycle', {'state': self.state})
        if self.state in (ACTIVE, INACTIVE):
            yield from self.collect_statuses()

    def close(self) -> None:
        """Leave what a configured node leaves at its end."""
        if self.state in (ACTIVE, INACTIVE):
            self.write_run_counts()

    def on_configure(self, _state: LifecycleState) -> Any:
        """Implement `LifecycleNode`."""

        def work() -> None:
            self.configure(self.parameter_set.build_configurations())
            self.parameter_set.apply_design = self.apply_design
            self.parameter_set.version += 1
            settle_process()

        return self._attempt('configure', work, INACTIVE)

    def on_activate(self, _state: LifecycleState) -> Any:
        """Implement `LifecycleNode`."""

        def work() -> None:
            self._gate = StartupGate(self, self.activate())
            # Peers are waited for once: later they may have gone, and that is no reason.
            self.working = self._gate.open or self._gate_passed

        return self._attempt('activate', work, ACTIVE)

    def on_deactivate(self, _state: LifecycleState) -> Any:
        """Implement `LifecycleNode`."""
        self.working = False
        return self._attempt('deactivate', self.deactivate, INACTIVE)

    def on_cleanup(self, _state: LifecycleState) -> Any:
        """Implement `LifecycleNode`."""
        return self._attempt('clean up', self._end, UNCONFIGURED)

    def on_shutdown(self, _state: LifecycleState) -> Any:
        """Implement `LifecycleNode`."""
        return self._attempt('shut down', self._end, FINALIZED)

    on_error = on_cleanup

    def _end(self) -> None:
        """Close, and destroy the ends of topics and services that `configure` has created."""
        self.close()
        self.parameter_set.apply_design = None
        self._diagnostics.restart()
        if self._gate is not None:
            self._lasting.append(self._gate.marker)
        self._gate, self.working, self.due = None, False, 0
        for destroy, ends in (
            (self.destroy_publisher, self.publishers),
            (self.destroy_subscription, self.subscriptions),
            (self.destroy_service, self.services),
        ):
            for end in [end for end in ends if end not in self._lasting]:
                destroy(end)
        gc.unfreeze()  # what `settle_process` froze
        gc.collect()

    def _attempt(self, what: str, work: Callable[[], None], goal: str) -> Any:
        """Do the work of a transition; rclpy would swallow what it raises."""
        self.get_logger().info(f'asked to {what}')
        try:
            work()
        except Exception as error:
            if self.state == UNCONFIGURED:
                self._end()
            if not isinstance(error, MulticontactError):
                self.get_logger().fatal(f'cannot {what}: {traceback.format_exc()}')
                return TransitionCallbackReturn.ERROR
            self._failure = error
            self.get_logger().error(f'cannot {what}: {error}')
            return FAILURE
        self.state = goal
        self.get_logger().info(goal)
        return SUCCESS

    def _change_if_possible(
        self, change: Callable[..., Any], request: Any, response: Any
    ) -> Any:
        """Answer a transition that is not possible now with no: rclpy raises."""
        try:
            return change(request, response)
        except RCLError as error:
            self.get_logger().error(f'change_state while {self.state}: {error}')
            response.success = False
            return response
