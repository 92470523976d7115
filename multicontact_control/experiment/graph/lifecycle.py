"""Leading managed nodes through their life cycle, from outside."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from multicontact_control.errors import RunError
from multicontact_control.nodes.guest import GuestNode
from rclpy.executors import SingleThreadedExecutor

CONFIGURE, ACTIVATE = 'configure', 'activate'
DEACTIVATE, CLEAN_UP, SHUT_DOWN = 'deactivate', 'cleanup', 'shutdown'
GOALS = {CONFIGURE: 'inactive', ACTIVATE: 'active', DEACTIVATE: 'inactive',
         CLEAN_UP: 'unconfigured', SHUT_DOWN: 'finalized'}
# s, for whoever has no time limit of their own: until a node is there, and has done its work.
PATIENCE = 300.0
ANSWER_TIMEOUT = 30.0
FIRST_TIMEOUT = 5.0  # an answer may be lost: then the state tells

KeepWaiting = Callable[[str], None]


class NoAnswerError(RunError):
    """A node does not answer."""


class TransitionError(RunError):
    """A node refused a transition; its log says why."""

    def __init__(self, node_name: str, transition: str) -> None:
        self.node_name = node_name
        super().__init__(f'{node_name} refused to {transition}')


class LifecycleDriver:
    """
    Changes the state of managed nodes.

    Parameters
    ----------
    domain_id
        ROS domain of the nodes.
    keep_waiting
        Called again and again while a node is waited for, with what is waited for; what it
        raises ends the waiting.
    namespace
        Of the nodes.
    poll_period
        Between two calls of `keep_waiting` [s].

    """

    def __init__(
        self, domain_id: int, keep_waiting: KeepWaiting = lambda what: None,
        namespace: str = '', poll_period: float = 0.1,
    ) -> None:
        self._keep_waiting, self._poll_period = keep_waiting, poll_period
        self._guest = GuestNode('lifecycle_driver', domain_id, namespace)
        self._executor = SingleThreadedExecutor(context=self._guest.context)
        self._executor.add_node(self._guest.node)
        self._clients: dict[tuple[str, str], Any] = {}

    def __enter__(self) -> LifecycleDriver:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._guest.close()

    def change(self, node_name: str, transition: str) -> None:
        """
        Lead a node through a transition.

        Raises
        ------
        TransitionError
            If the node refuses.
        NoAnswerError
            If it does not answer.

        """
        request = ChangeState.Request(transition=Transition(label=transition))
        give_up = time.monotonic() + PATIENCE
        while time.monotonic() < give_up:
            answer = self.call(node_name, ChangeState, 'change_state', request, FIRST_TIMEOUT,
                               doing=transition)
            if answer is None:
                # The answer may be lost although the work is done, or yet to come: a node at
                # work tells its state when it has done it.
                answer = self.call(
                    node_name, GetState, 'get_state', GetState.Request(), doing=transition)
                if answer is None or answer.current_state.label != GOALS[transition]:
                    continue  # or the request: one that was killed seems to listen for a while
            elif not answer.success:
                raise TransitionError(node_name, transition)
            return
        raise NoAnswerError(f'{node_name} did not answer when asked to {transition}')

    def state(self, node_name: str, timeout: float = ANSWER_TIMEOUT) -> str:
        """
        Return the state of a node.

        Raises
        ------
        NoAnswerError
            If it does not answer within `timeout` [s].

        """
        answer = self.call(node_name, GetState, 'get_state', GetState.Request(), timeout)
        if answer is None:
            raise NoAnswerError(f'{node_name} did not tell its state')
        return str(answer.current_state.label)

    def call(
        self, node_name: str, service: Any, name: str, request: Any,
        timeout: float = ANSWER_TIMEOUT, doing: str = 'answer',
    ) -> Any:
        """
        Call a service of a node.

        Parameters
        ----------
        node_name
            The node.
        service, name, request
            Type and name of its service, and what to ask.
        timeout
            Longest wait for the answer [s].
        doing
            What the node has to do until it answers.

        Returns
        -------
        object
            The response, None without one within `timeout` [s].

        Raises
        ------
        NoAnswerError
            If there is no such service for `PATIENCE`.

        """
        client = self._clients.get((node_name, name))
        if client is None:
            client = self._guest.node.create_client(service, f'{node_name}/{name}')
            self._clients[node_name, name] = client
        if not self._wait(client.service_is_ready, PATIENCE, f'{node_name} to appear'):
            raise NoAnswerError(f'{node_name} did not appear in {PATIENCE:g} s')
        future = client.call_async(request)
        if self._wait(future.done, timeout, f'{node_name} to {doing}'):
            return future.result()
        client.remove_pending_request(future)
        return None

    def _wait(self, condition: Callable[[], Any], timeout: float, what: str) -> bool:
        """Return whether a condition came true in time; errors of `keep_waiting` go through."""
        give_up = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > give_up:
                return False
            self._keep_waiting(what)
            self._executor.spin_once(timeout_sec=self._poll_period)
        return True
