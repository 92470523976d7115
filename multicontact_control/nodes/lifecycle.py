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

UNCONFIGURED = 'unconfigured'
INACTIVE = 'inactive'
ACTIVE = 'active'
FINALIZED = 'finalized'
CONFIGURED = (INACTIVE, ACTIVE)  # states with subscriptions, publishers and services
SPIN_TIMEOUT = 0.02  # s, between two looks at the gate and at what is due
DRAIN_TIME = 0.1  # s, at the end, for callbacks of what has arrived or is on its way
SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE


class ManagedNode(LifecycleNode):
    """
    What the managed nodes of the graph share: transitions, parameters, gate, diagnostics.

    A transition that fails says why in one line and leaves the node where it was. rclpy runs
    callbacks of messages in every state: they look at `state`.

    Parameters
    ----------
    name, models
        Name of the node, and the models of which its parameters are declared.
    options
        Those of `rclpy.node.Node`.

    Attributes
    ----------
    state, working
        State of the life cycle; whether the node is active and its peers have been there.
    due
        When `do_due_work` is called at the latest, monotonic time [ns]; 0 for now and then.
    refusals, background
        Log of the messages and changes that are refused; thread for work that takes longer than
        a sample may wait.

    """

    def __init__(self, name: str, *models: type[Config], **options: Any) -> None:
        super().__init__(name, **options)
        self.state = UNCONFIGURED
        self.working = False
        self.due = 0
        self.refusals = RefusalLog(self.get_logger())
        self.parameter_set = ParameterSet(self, *models)
        self.parameter_set.report_refusal = self.refusals.log_refusal
        self.parameter_set.compute_design = self.compute_design
        self.background = BackgroundThread()
        self._changes = LiveChanges(self, self.parameter_set, self.background)
        self._diagnostics = DiagnosticsPublisher(
            self, self._collect_all_statuses, self.background
        )
        self._gate: StartupGate | None = None
        self._gate_passed = False
        self._failure = MulticontactError('the node cannot be started')
        service = change_state_service(self)
        service.callback = partial(self._change_if_possible, service.callback)
        # Publishers, subscriptions and services that outlive a configuration.
        self._lasting: list[Any] = [
            *self.publishers,
            *self.subscriptions,
            *self.services,
        ]

    @abstractmethod
    def configure(self, configurations: Sequence[Any]) -> None:
        """
        Load what the node needs, and create its publishers, subscriptions and services.

        `configurations` has one validated configuration per model. A MulticontactError leaves the
        node unconfigured and is logged in one line.
        """

    @abstractmethod
    def activate(self) -> StartupConfig:
        """Forget the past and begin; return the configuration with the peers to wait for."""

    @abstractmethod
    def write_run_counts(self) -> None:
        """Write the counts of the run; publishers and the like are destroyed afterwards."""

    @abstractmethod
    def collect_statuses(self) -> Iterable[ComponentStatus | None]:
        """Yield the statuses of the diagnostics, and None where a sample may come between."""

    def deactivate(self) -> None:
        """Stop the node's work; a node that answers nothing while inactive has none to stop."""

    def compute_design(self, configurations: Sequence[Any]) -> Any:
        """
        Return what changed configurations lead to, for `apply_design`.

        Called by another thread, since it may take longer than a sample may wait. A
        MulticontactError refuses the change, and its text is the answer to who asked for it.
        """
        return configurations

    def apply_design(self, design: Any) -> None:
        """Go on with a design between two samples; MulticontactError changes nothing."""

    def do_due_work(self, spinner: Spinner) -> None:
        """Do what is due; called after each callback, at `due`, and when the gate has opened."""

    def shutdown_safely(self, spinner: Spinner) -> None:
        """Do what a robot or a peer needs between the request to stop and the end."""

    def run(self, spinner: Spinner) -> None:
        """
        Run callbacks until asked to stop or shut down.

        With `--autostart` among the arguments the node configures and activates itself before, and
        the MulticontactError of a transition that fails ends it.
        """
        if AUTOSTART in sys.argv:
            for trigger_transition in (self.trigger_configure, self.trigger_activate):
                if trigger_transition() != SUCCESS:
                    raise self._failure
        while not (spinner.stop or self.state == FINALIZED):
            self.spin_once(spinner)
        self.shutdown_safely(spinner)
        end = time.monotonic() + DRAIN_TIME
        while time.monotonic() < end:
            spinner.spin_once(SPIN_TIMEOUT)

    def spin_once(self, spinner: Spinner) -> None:
        """Wait for one callback until `due` at most; then do what is due between two callbacks."""
        timeout = SPIN_TIMEOUT
        if self.due:
            until_due = (self.due - time.monotonic_ns()) * 1e-9
            timeout = min(timeout, max(0.0, until_due))
        spinner.spin_once(timeout)
        if self.state == ACTIVE and not self.working and self._gate is not None:
            self.working = self._gate_passed = self._gate.poll()
        if self.working or self.state == INACTIVE:
            self.do_due_work(spinner)
        self._changes.poll()
        self._diagnostics.poll()

    def _collect_all_statuses(self) -> Iterator[ComponentStatus | None]:
        yield ComponentStatus('life cycle', {'state': self.state})
        if self.state in CONFIGURED:
            yield from self.collect_statuses()

    def close(self) -> None:
        """Write the counts of the run that ends, unless it has never been configured."""
        if self.state in CONFIGURED:
            self.write_run_counts()

    def on_configure(self, _state: LifecycleState) -> Any:
        """Implement the transition of `LifecycleNode` from unconfigured to inactive."""
        return self._attempt_transition(
            'configure', self._configure_completely, INACTIVE
        )

    def on_activate(self, _state: LifecycleState) -> Any:
        """Implement the transition of `LifecycleNode` from inactive to active."""
        return self._attempt_transition('activate', self._activate_behind_gate, ACTIVE)

    def on_deactivate(self, _state: LifecycleState) -> Any:
        """Implement the transition of `LifecycleNode` from active to inactive."""
        self.working = False
        return self._attempt_transition('deactivate', self.deactivate, INACTIVE)

    def on_cleanup(self, _state: LifecycleState) -> Any:
        """Implement the transition of `LifecycleNode` from inactive to unconfigured."""
        return self._attempt_transition('clean up', self._release, UNCONFIGURED)

    def on_shutdown(self, _state: LifecycleState) -> Any:
        """Implement the transition of `LifecycleNode` from any state to finalized."""
        return self._attempt_transition('shut down', self._release, FINALIZED)

    on_error = on_cleanup

    def _configure_completely(self) -> None:
        self.configure(self.parameter_set.build_configurations())
        self.parameter_set.apply_design = self.apply_design
        self.parameter_set.version += 1
        settle_process()

    def _activate_behind_gate(self) -> None:
        self._gate = StartupGate(self, self.activate())
        # Peers are waited for once: later they may have gone, and that is no reason.
        self.working = self._gate.open or self._gate_passed

    def _release(self) -> None:
        """Close, and destroy the publishers and the like that `configure` has created."""
        self.close()
        self.parameter_set.apply_design = None
        self._diagnostics.restart()
        if self._gate is not None:
            self._lasting.append(self._gate.marker)
        self._gate = None
        self.working = False
        self.due = 0
        for destroy, entities in (
            (self.destroy_publisher, [*self.publishers]),
            (self.destroy_subscription, [*self.subscriptions]),
            (self.destroy_service, [*self.services]),
        ):
            for entity in entities:
                if entity not in self._lasting:
                    destroy(entity)
        gc.unfreeze()  # what `settle_process` froze
        gc.collect()

    def _attempt_transition(
        self, name: str, work: Callable[[], None], goal: str
    ) -> Any:
        """Do the work of a transition; rclpy would swallow what it raises."""
        self.get_logger().info(f'asked to {name}')
        try:
            work()
        except Exception as error:
            if self.state == UNCONFIGURED:
                self._release()
            if not isinstance(error, MulticontactError):
                self.get_logger().fatal(f'cannot {name}: {traceback.format_exc()}')
                return TransitionCallbackReturn.ERROR
            self._failure = error
            self.get_logger().error(f'cannot {name}: {error}')
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
