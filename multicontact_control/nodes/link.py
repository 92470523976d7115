"""A process that is none of the graph's takes part in it: a node of its own, services, topics."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
import math
import os
import threading
import time
from typing import Any, TypeVar

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from multicontact_control.errors import RunError
from multicontact_control.nodes import qos, topics
from multicontact_control.nodes.graph import create_publisher, take
from multicontact_control.nodes.runtime import prepare_environment
from multicontact_control.nodes.status import (
    ControllerStatus,
    identify,
    new_identifier,
    REFUSED,
)
from multicontact_control.nodes.topics import Topic
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.subscription import Subscription

CONFIGURE, ACTIVATE = 'configure', 'activate'
DEACTIVATE, CLEAN_UP, SHUT_DOWN = 'deactivate', 'cleanup', 'shutdown'
GOALS = {CONFIGURE: 'inactive', ACTIVATE: 'active', DEACTIVATE: 'inactive',
         CLEAN_UP: 'unconfigured', SHUT_DOWN: 'finalized'}
PATIENCE = 300.0  # s, until a node is there, and has done its work
ANSWER_TIMEOUT = 30.0  # s
FIRST_TIMEOUT = 5.0  # s; an answer may be lost: then the state tells
ASK_PERIOD = 1.0  # s
RESEND_PERIOD = 0.2  # s, of a command that is not answered
WAIT_PERIOD = 0.02  # s, for services
POLL_PERIOD = 0.001  # s, for messages

T = TypeVar('T')
GuestT = TypeVar('GuestT', bound='GuestNode')
_lock = threading.Lock()
_shared: dict[int | None, list[Node]] = {}


class CommandRefusedError(RunError):
    """The controller refuses a command, and says why."""


class NoAnswerError(RunError):
    """A node does not answer."""


class TransitionError(RunError):
    """A node refused a transition; its log says why."""


class GuestNode:
    """
    A node without parameters and logs, in a context that all guests of a domain share.

    A context is a participant of DDS as long as it has a node. Fast DDS 2.14 can wait for itself
    for ever when a participant leaves while others come and go, so that a process has one, which
    leaves with its last guest. The domain is that of the environment by default.
    """

    def __init__(self, name: str, domain_id: int | None = None, namespace: str = '') -> None:
        prepare_environment()
        self._domain_id = domain_id
        with _lock:
            guests = _shared.setdefault(domain_id, [])
            self.context = guests[0].context if guests else Context()
            if not guests:
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
            if self.node in guests:
                guests.remove(self.node)
                self.node.destroy_node()
                if not guests:
                    self.context.try_shutdown()


class LifecycleDriver(GuestNode):
    """
    Calls services and changes the state of managed nodes.

    `keep_waiting` is called with what is waited for while a node is; what it raises ends the
    waiting. `patience` is the longest wait for a node to appear, and to do its work [s].
    """

    def __init__(
        self, domain_id: int | None, keep_waiting: Callable[[str], None] = lambda what: None,
        namespace: str = '', *, patience: float = PATIENCE, name: str = 'lifecycle_driver',
    ) -> None:
        super().__init__(name, domain_id, namespace)
        self._keep_waiting, self._patience = keep_waiting, patience
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

    def change(self, node_name: str, transition: str) -> None:
        """Lead a node to where a transition goes; TransitionError if it refuses, NoAnswerError."""
        request = ChangeState.Request(transition=Transition(label=transition))
        give_up = time.monotonic() + self._patience
        while (left := give_up - time.monotonic()) > 0.0:
            asked = self._ready(node_name, ChangeState, 'change_state').call_async(request)
            # Request or answer may be lost: then the state tells. A node at work answers later.
            self._wait(asked.done, min(FIRST_TIMEOUT, left), f'{node_name} to {transition}')
            if asked.done() and asked.result().success or (
                    self.state(node_name, left) == GOALS[transition]):
                return
            if asked.done():
                raise TransitionError(f'{node_name} refused to {transition}; its log says why')
        raise NoAnswerError(f'{node_name} did not answer when asked to {transition}')

    def state(self, node_name: str, timeout: float = ANSWER_TIMEOUT) -> str:
        """Return the state of a node; NoAnswerError without an answer within `timeout` [s]."""
        give_up = time.monotonic() + min(timeout, self._patience)
        while True:
            # One that is killed and started again seems to listen meanwhile, and never answers.
            try:
                return str(self.call(node_name, GetState, 'get_state', GetState.Request(),
                                     ASK_PERIOD).current_state.label)
            except NoAnswerError:
                if time.monotonic() > give_up:
                    raise

    def has_lifecycle(self, node_name: str, wait: float) -> bool:
        """Return whether a node has a lifecycle, looking for it for up to `wait` [s]."""
        client = self._client(node_name, GetState, 'get_state')
        return self._wait(client.service_is_ready, wait, f'{node_name} to appear')

    def call(
        self, node_name: str, service: Any, name: str, request: Any, timeout: float = math.inf,
    ) -> Any:
        """
        Return the response of a service of a node.

        Raises NoAnswerError without one within `timeout`, or the patience if that is shorter [s].
        """
        client, timeout = self._ready(node_name, service, name), min(timeout, self._patience)
        future = client.call_async(request)
        if not self._wait(future.done, timeout, f'{node_name} to answer'):
            client.remove_pending_request(future)
            raise NoAnswerError(
                f'{client.service_name}: expected an answer within {timeout:g} s, found none')
        return future.result()

    def _ready(self, node_name: str, service: Any, name: str) -> Any:
        """Return the client of a service that is there; see `call`."""
        client = self._client(node_name, service, name)
        if not self._wait(client.service_is_ready, self._patience, f'{node_name} to appear'):
            raise NoAnswerError(f'{client.service_name}: expected this service within '
                                f'{self._patience:g} s, found none')
        return client

    def _client(self, node_name: str, service: Any, name: str) -> Any:
        if (node_name, name) not in self._clients:
            self._clients[node_name, name] = self.node.create_client(
                service, f'{node_name}/{name}')
        return self._clients[node_name, name]

    def _wait(self, condition: Callable[[], Any], timeout: float, what: str) -> bool:
        """Return whether a condition came true in time; errors of `keep_waiting` go through."""
        give_up = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > give_up:
                return False
            self._keep_waiting(what)
            self._executor.spin_once(timeout_sec=WAIT_PERIOD)
        return True


class ControllerLink(LifecycleDriver):
    """
    One end of a connection to a running controller, without a thread.

    Parameters
    ----------
    newest, queued
        Topics of which the newest message is kept, and of which all are, until they are looked at.
    namespace, domain_id, timeout
        Where the controller is, and longest wait for anything [s].
    on_status
        Called with each status of the controller that `look` takes; `status` is the last.

    """

    def __init__(
        self, newest: Sequence[Topic], *, queued: Sequence[Topic] = (), namespace: str,
        domain_id: int | None, timeout: float,
        on_status: Callable[[ControllerStatus], None] = lambda status: None,
    ) -> None:
        super().__init__(domain_id, namespace=namespace, patience=timeout,
                         name=f'multicontact_client_{os.getpid()}')
        self._kept: dict[Topic, deque[Any]] = {}
        self._subscriptions: dict[Topic, Subscription] = {}
        for topic in (*newest, *queued, topics.STATUS):
            glance = qos.LATCHED if topic.profile == qos.LATCHED else qos.GLANCE
            kept = self._kept[topic] = deque(maxlen=1 if topic in newest else None)
            # The executor, which waits for services, may be faster than `_taken`.
            self._subscriptions[topic] = self.node.create_subscription(
                topic.message, topic.name, lambda message, kept=kept: kept.append(message),
                glance if topic in newest else qos.QUEUE)
        self._publishers = {topic: create_publisher(self.node, topic)
                            for topic in (topics.FORCE_COMMAND, topics.MOTION_COMMAND)}
        self._on_status = on_status
        self.status: ControllerStatus | None = None

    def _taken(self, topic: Topic) -> deque[Any]:
        kept = self._kept[topic]
        while (taken := take(self._subscriptions[topic])) is not None:
            kept.append(taken[0])
        return kept

    def newest(self, topic: Topic) -> Any | None:
        """Return the newest message of a topic, None if none has come so far."""
        kept = self._taken(topic)
        return kept[-1] if kept else None

    def queue(self, topic: Topic) -> list[Any]:
        """Return the messages of a topic that have come since this was called last."""
        found = list(self._taken(topic))
        self._kept[topic].clear()
        return found

    def fresh(self, *wanted: Topic) -> list[Any]:
        """Return a message of each topic that comes from now on; RunError if none comes."""
        for topic in wanted:
            self._taken(topic).clear()
        return [self._awaited(partial(self.newest, topic), f'{topic.name}: expected a message')
                for topic in wanted]

    def fresh_sample(self, *wanted: Topic) -> list[Any]:
        """Return messages like `fresh`, all with the same stamp."""
        def of_one_stamp() -> list[Any] | None:
            found: list[Any] = [self.newest(topic) for topic in wanted]
            stamps = [x.header.stamp for x in found]
            return found if stamps.count(stamps[0]) == len(stamps) else None

        self.fresh(*wanted)
        names = ', '.join(topic.name for topic in wanted)
        return self._awaited(of_one_stamp, f'{names}: expected messages of one stamp')

    def _awaited(self, found: Callable[[], T | None], missing: str) -> T:
        give_up = time.monotonic() + self._patience
        while (value := found()) is None:
            if time.monotonic() > give_up:
                raise RunError(f'{missing} within {self._patience:g} s, found none; is the '
                               'controller active?')
            time.sleep(POLL_PERIOD)
        return value

    def look(self) -> list[ControllerStatus]:
        """Return what the controller has said of itself and of commands since the last look."""
        found = [ControllerStatus.of(message) for message in self.queue(topics.STATUS)]
        for self.status in found:
            self._on_status(self.status)
        return found

    def send(self, topic: Topic, command: Any, identifier: str) -> None:
        """Publish a command once, without waiting for an answer."""
        identify(command, identifier)
        self._publishers[topic].publish(command)

    def accepted(self, identifier: str) -> bool | None:
        """Return True if a command was accepted since the last look; CommandRefusedError."""
        answers = [status for status in self.look() if status.command == identifier]
        for answer in answers:
            if answer.event == REFUSED:
                raise CommandRefusedError(answer.text)
        return True if answers else None

    def command(self, topic: Topic, command: Any) -> None:
        """Publish a command until it is accepted; CommandRefusedError, RunError without answer."""
        identifier, due = new_identifier(), 0.0

        def accepted() -> bool | None:
            nonlocal due
            if time.monotonic() >= due:  # one that comes before the connection stands is lost
                due = time.monotonic() + RESEND_PERIOD
                self.send(topic, command, identifier)
            return self.accepted(identifier)

        self._awaited(accepted, f'{topic.name}: expected an answer')
