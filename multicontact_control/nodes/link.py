"""
How a process that is none of the graph's takes part in it: a command, a client, a campaign.

A node of its own in a context that is shared, services, and the life cycle of managed nodes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
import math
import os
import threading
import time
from typing import Any, TypeVar

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from multicontact_control.errors import RunError
from multicontact_control.nodes import qos
from multicontact_control.nodes.graph_node import (
    create_publisher,
    quality_mismatches,
    take,
)
from multicontact_control.nodes.runtime import prepare_environment
from multicontact_control.nodes.topics import CONTROLLER, Topic
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

CONFIGURE, ACTIVATE = 'configure', 'activate'
DEACTIVATE, CLEAN_UP, SHUT_DOWN = 'deactivate', 'cleanup', 'shutdown'
GOALS = {CONFIGURE: 'inactive', ACTIVATE: 'active', DEACTIVATE: 'inactive',
         CLEAN_UP: 'unconfigured', SHUT_DOWN: 'finalized'}
# s, for whoever has no time limit of their own: until a node is there, and has done its work.
PATIENCE = 300.0
ANSWER_TIMEOUT = 30.0
FIRST_TIMEOUT = 5.0  # an answer may be lost: then the state tells
ASK_PERIOD = 1.0
POLL_PERIOD = 0.001

KeepWaiting = Callable[[str], None]
GuestT = TypeVar('GuestT', bound='GuestNode')
_lock = threading.Lock()
_shared: dict[int | None, list[Node]] = {}


class NoAnswerError(RunError):
    """A node does not answer."""


class TransitionError(RunError):
    """A node refused a transition; its log says why."""

    def __init__(self, node_name: str, transition: str) -> None:
        self.node_name = node_name
        super().__init__(f'{node_name} refused to {transition}; its log says why')


class GuestNode:
    """
    A node without parameters and logs, in a context that all guests of a domain share.

    A context is a participant of DDS as long as it has a node. Fast DDS 2.14 can wait for itself
    for ever when a participant leaves while others come and go, so that a process has one, which
    leaves with its last guest.

    Parameters
    ----------
    name, namespace
        Of the node.
    domain_id
        ROS domain; that of the environment by default.

    Attributes
    ----------
    context, node
        What rclpy calls so.

    """

    def __init__(self, name: str, domain_id: int | None = None, namespace: str = '') -> None:
        prepare_environment()
        self._domain_id = domain_id
        with _lock:
            guests = _shared.setdefault(domain_id, [])
            if guests:
                self.context = guests[0].context
            else:
                self.context = Context()
                self.context.init(args=[], domain_id=domain_id)
            self.node = Node(
                name, namespace=namespace, context=self.context, use_global_arguments=False,
                start_parameter_services=False, enable_rosout=False)
            guests.append(self.node)

    def __enter__(self: GuestT) -> GuestT:
        """Return the guest itself."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Leave the graph."""
        self.close()

    def close(self) -> None:
        """Leave the graph; nothing if that is done."""
        with _lock:
            guests = _shared[self._domain_id]
            if self.node not in guests:
                return
            guests.remove(self.node)
            self.node.destroy_node()
            if not guests:
                self.context.try_shutdown()


class LifecycleDriver(GuestNode):
    """
    Calls services and changes the state of managed nodes.

    Parameters
    ----------
    domain_id
        ROS domain of the nodes; that of the environment by default.
    keep_waiting
        Called again and again while a node is waited for, with what is waited for; what it
        raises ends the waiting.
    namespace
        Of the nodes.
    poll_period
        Between two calls of `keep_waiting` [s].
    patience
        Longest wait for a node to appear, and to do its work [s].
    name
        Of the guest.

    """

    def __init__(
        self, domain_id: int | None, keep_waiting: KeepWaiting = lambda what: None,
        namespace: str = '', poll_period: float = 0.1, *, patience: float = PATIENCE,
        name: str = 'lifecycle_driver',
    ) -> None:
        super().__init__(name, domain_id, namespace)
        self._keep_waiting, self._poll_period = keep_waiting, poll_period
        self._patience = patience
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._clients: dict[tuple[str, str], Any] = {}

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        super().close()

    def bring_up(self, node_name: str) -> bool:
        """Configure and activate a node, as far as it is not; return whether it was not active."""
        if self.state(node_name) == 'unconfigured':
            self.change(node_name, CONFIGURE)
        inactive = self.state(node_name) == 'inactive'
        if inactive:
            self.change(node_name, ACTIVATE)
        return inactive

    def take_down(self, node_name: str) -> None:
        """Deactivate a node if it is active."""
        if self.state(node_name) == 'active':
            self.change(node_name, DEACTIVATE)

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
        asked: list[Any] = []  # an answer may only be late: all are waited for
        lost, give_up = True, time.monotonic() + self._patience
        while time.monotonic() < give_up:
            if lost and not any(future.done() for future in asked):
                asked.append(self._ready(node_name, ChangeState, 'change_state').call_async(
                    request))
            self._wait(lambda: all(future.done() for future in asked),
                       min(FIRST_TIMEOUT, self._patience), f'{node_name} to {transition}')
            answers = [future.result().success for future in asked if future.done()]
            if any(answers):
                return
            if len(asked) > 1 or not answers:
                # The answer may be lost although the work is done (then a second request is
                # refused), or yet to come: a node at work tells its state when it has done it,
                # or that it is at work. Or the request: one that was killed seems to listen for
                # a while.
                found = self.call(
                    node_name, GetState, 'get_state', GetState.Request(), doing=transition)
                state = '' if found is None else found.current_state.label
                if state == GOALS[transition]:
                    return
                lost = bool(state) and not state.endswith('ing')
                if not (answers and lost):
                    continue
            raise TransitionError(node_name, transition)
        raise NoAnswerError(f'{node_name} did not answer when asked to {transition}')

    def state(self, node_name: str, timeout: float = ANSWER_TIMEOUT) -> str:
        """Return the state of a node; NoAnswerError without an answer within `timeout` [s]."""
        # One that is killed and started again seems to listen meanwhile, and never answers.
        answer = self.call(node_name, GetState, 'get_state', GetState.Request(), timeout,
                           ask_period=ASK_PERIOD)
        if answer is None:
            raise NoAnswerError(f'{node_name} did not tell its state')
        return str(answer.current_state.label)

    def has_lifecycle(self, node_name: str, wait: float) -> bool:
        """Return whether a node has a lifecycle, looking for it for up to `wait` [s]."""
        client = self._client(node_name, GetState, 'get_state')
        return self._wait(client.service_is_ready, wait, f'{node_name} to appear')

    def call(
        self, node_name: str, service: Any, name: str, request: Any,
        timeout: float = ANSWER_TIMEOUT, doing: str = 'answer', ask_period: float = math.inf,
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
        ask_period
            From one time that it is asked to the next; once by default [s].

        Returns
        -------
        object
            The response, None without one within `timeout` [s].

        Raises
        ------
        NoAnswerError
            If there is no such service.

        """
        client = self._ready(node_name, service, name)
        asked: list[Any] = []  # an answer may only be late: all are waited for
        give_up, answer = time.monotonic() + min(timeout, self._patience), None
        while answer is None and (left := give_up - time.monotonic()) > 0.0:
            asked.append(client.call_async(request))
            self._wait(lambda: any(future.done() for future in asked), min(ask_period, left),
                       f'{node_name} to {doing}')
            answer = next((future.result() for future in asked if future.done()), None)
        for future in asked:
            if not future.done():
                client.remove_pending_request(future)
        return answer

    def _ready(self, node_name: str, service: Any, name: str) -> Any:
        """Return the client of a service that is there; see `call`."""
        client = self._client(node_name, service, name)
        if not self._wait(client.service_is_ready, self._patience, f'{node_name} to appear'):
            raise NoAnswerError(f'{client.service_name}: expected this service within '
                                f'{self._patience:g} s, found none')
        return client

    def _client(self, node_name: str, service: Any, name: str) -> Any:
        client = self._clients.get((node_name, name))
        if client is None:
            client = self.node.create_client(service, f'{node_name}/{name}')
            self._clients[node_name, name] = client
        return client

    def _wait(self, condition: Callable[[], Any], timeout: float, what: str) -> bool:
        """Return whether a condition came true in time; errors of `keep_waiting` go through."""
        give_up = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > give_up:
                return False
            self._keep_waiting(what)
            self._executor.spin_once(timeout_sec=self._poll_period)
        return True


class ControllerLink(LifecycleDriver):
    """
    One end of a connection to a running controller, without a thread.

    Subscriptions hold the newest message and are looked at when one is wanted.

    Parameters
    ----------
    topics
        What to listen to.
    queued
        What to listen to without losing anything.
    namespace, domain_id
        Where the controller is.
    timeout
        Longest wait for anything [s].

    """

    def __init__(
        self, topics: Sequence[Topic], *, queued: Sequence[Topic] = (), namespace: str,
        domain_id: int | None, timeout: float,
    ) -> None:
        super().__init__(domain_id, namespace=namespace, patience=timeout,
                         name=f'multicontact_client_{os.getpid()}')
        self._queued: dict[Topic, deque[Any]] = {topic: deque() for topic in queued}
        self._queues: dict[Topic, Subscription] = {
            topic: self._keep_all(topic) for topic in queued}
        self._newest: dict[Topic, Any] = {}
        # How many readers a topic had when the controller was among them.
        self._reached: dict[str, int] = {}
        self._subscriptions: dict[Topic, Subscription] = {
            topic: self._listen(topic) for topic in topics}

    def _listen(self, topic: Topic) -> Subscription:
        # The executor may be faster than `newest`.
        def keep(message: Any) -> None:
            self._newest[topic] = message
        return self.node.create_subscription(
            topic.message, topic.name, keep,
            qos.LATCHED if topic.profile == qos.LATCHED else qos.GLANCE)

    def _keep_all(self, topic: Topic) -> Subscription:
        # The executor may be faster than `queue`.
        def keep(message: Any) -> None:
            self._queued[topic].append(message)
        return self.node.create_subscription(topic.message, topic.name, keep, qos.QUEUE)

    def publisher(self, topic: Topic) -> Publisher:
        """Return a publisher of a command."""
        return create_publisher(self.node, topic)

    def publish(self, publisher: Publisher, message: Any) -> None:
        """Publish a command once the controller listens; RunError if it does not."""
        self.wait_for_controller(publisher)
        publisher.publish(message)

    def wait_for_controller(self, publisher: Publisher) -> None:
        """Wait until the controller gets what is published; RunError if it does not listen."""
        give_up = time.monotonic() + self._patience
        while not self._reaches_controller(publisher):
            if time.monotonic() > give_up:
                raise RunError(
                    f'{publisher.topic_name}: expected a controller that listens within '
                    f'{self._patience:g} s, found none; is it configured?')
            time.sleep(POLL_PERIOD)

    def _reaches_controller(self, publisher: Publisher) -> bool:
        """Return whether the controller is among the readers."""
        name, count = publisher.topic_name, publisher.get_subscription_count()
        if count and count == self._reached.get(name):  # looking it up takes longer
            return True
        readers = self.node.get_subscriptions_info_by_topic(name)
        unlike = quality_mismatches(self.node, name, publisher.qos_profile, publishing=True)
        found = count >= max(1, len(readers) - len(unlike)) and CONTROLLER in [
            reader.node_name for reader in readers]
        if found:
            self._reached[name] = count
        return found

    def fresh(self, *topics: Topic) -> list[Any]:
        """Return a message of each topic that comes from now on; RunError if none comes."""
        for topic in topics:
            self.newest(topic)
            self._newest.pop(topic, None)
        return [self._wait_for(topic) for topic in topics]

    def fresh_sample(self, *topics: Topic) -> list[Any]:
        """Return messages like `fresh`, all with the same stamp."""
        found, give_up = self.fresh(*topics), time.monotonic() + self._patience
        while any(message.header.stamp != found[0].header.stamp for message in found):
            if time.monotonic() > give_up:
                raise RunError(
                    f'{", ".join(topic.name for topic in topics)}: expected messages of one '
                    f'stamp within {self._patience:g} s, found none')
            time.sleep(POLL_PERIOD)
            found = [self.newest(topic) for topic in topics]
        return found

    def queue(self, topic: Topic) -> list[Any]:
        """Return the messages of a topic that have come since this was called last."""
        waiting = self._queued[topic]
        while (taken := take(self._queues[topic])) is not None:
            waiting.append(taken[0])
        found = list(waiting)
        waiting.clear()
        return found

    def is_heard(self, topic: Topic, timeout: float) -> bool:
        """Return whether somebody publishes a topic, looking for up to a time [s]."""
        give_up = time.monotonic() + timeout
        while self._queues[topic].get_publisher_count() == 0:
            if time.monotonic() > give_up:
                return False
            time.sleep(POLL_PERIOD)
        return True

    def newest(self, topic: Topic) -> Any | None:
        """Return the newest message of a topic, None if none has come so far."""
        while (taken := take(self._subscriptions[topic])) is not None:
            self._newest[topic] = taken[0]
        return self._newest.get(topic)

    def _wait_for(self, topic: Topic) -> Any:
        give_up = time.monotonic() + self._patience
        while (message := self.newest(topic)) is None:
            if time.monotonic() > give_up:
                raise RunError(f'{topic.name}: expected a message within {self._patience:g} s, '
                               'found none; is the controller active?')
            time.sleep(POLL_PERIOD)
        return message

    def require(self, node_name: str, service: Any, name: str, request: Any) -> Any:
        """Return the answer of a service of a node; RunError without one."""
        answer = self.call(node_name, service, name, request, self._patience)
        if answer is None:
            full = self.node.resolve_service_name(f'{node_name}/{name}')
            raise RunError(f'{full}: expected an answer within {self._patience:g} s')
        return answer
