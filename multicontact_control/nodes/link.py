"""A process that is none of the graph's takes part in it: a node of its own, services, topics."""

from __future__ import annotations

import atexit
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
import os
import time
from typing import Any, TypeVar

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from multicontact_control.errors import MessageError, RunError
from multicontact_control.nodes import qos, topics
from multicontact_control.nodes.graph import create_publisher, take_message
from multicontact_control.nodes.messages import (
    ControllerStatus,
    new_identifier,
    REFUSED,
    set_identifier,
)
from multicontact_control.nodes.runtime import start_ros
from multicontact_control.nodes.topics import Topic
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

CONFIGURE = 'configure'
ACTIVATE = 'activate'
DEACTIVATE = 'deactivate'
GOALS = {  # state that each transition leads to
    CONFIGURE: 'inactive',
    ACTIVATE: 'active',
    DEACTIVATE: 'inactive',
    'cleanup': 'unconfigured',
}
LARGEST_DOMAIN = 232  # for which there are ports
PATIENCE = 300.0  # s, until a node is there, and has done its work
FIRST_TIMEOUT = 5.0  # s; an answer may be lost: then the state tells
ASK_PERIOD = 1.0  # s, between two requests that change nothing
QUEUED = (topics.STATUS, topics.DIAGNOSTICS)  # of which no message may be missed
RESEND_PERIOD = 0.2  # s, of a command that is not answered
CONNECTION_TIME = 2.0  # s, that the first command waits for all its readers at most
SERVICE_PERIOD = 0.02  # s, of looking for a service and its answer
MESSAGE_PERIOD = 0.001  # s, of looking for messages

T = TypeVar('T')
ClientT = TypeVar('ClientT', bound='ServiceClientNode')


class CommandRefusedError(RunError):
    """The controller refuses a command; the text is its reason."""


class NoAnswerError(RunError):
    """A service is missing or does not answer in time; the text names it and the time."""


class TransitionError(RunError):
    """A node refused a transition of its life cycle; the node's log says why."""


@cache
def _join_domain(domain_id: int) -> Context:
    """Return the context of all clients of a domain: one participant until the process ends."""
    # Fast DDS 2.14 can wait for itself for ever when one leaves while others come and go.
    context = Context()
    start_ros([], context=context, domain_id=domain_id)
    atexit.register(context.try_shutdown)
    return context


def _validate_domain(domain_id: int | None) -> int:
    """Return the number of a ROS domain, by default that of the environment; MessageError."""
    given: object = domain_id
    if domain_id is None:
        given = os.environ.get('ROS_DOMAIN_ID') or '0'
    try:
        number = int(str(given))
    except ValueError:
        number = -1
    if not 0 <= number <= LARGEST_DOMAIN:
        raise MessageError(
            'domain_id', f'a whole number from 0 to {LARGEST_DOMAIN}', repr(given)
        )
    return number


def _parameter_message(name: str, value: Any) -> Any:
    """Return the message of a parameter; MessageError for a value that is of none of its types."""
    try:
        return Parameter(name, value=value).to_parameter_msg()
    except (TypeError, ValueError, AssertionError):
        raise MessageError(
            str(name),
            'a number, a text, a truth value or a list of one of these',
            repr(value),
        ) from None


def _keep_waiting(_what: str) -> None:
    """Go on waiting for a node."""


class ServiceClientNode:
    """
    A node that calls services, parameters and transitions of other nodes, and has none itself.

    It is a context manager, and destroys the node at its end.

    Parameters
    ----------
    name, domain_id, namespace
        Name of the node; its ROS domain, by default that of the environment; its namespace.
    patience
        How long it waits for a node to appear or to work [s].
    keep_waiting
        Called meanwhile, every `SERVICE_PERIOD`, with the text of what is waited for; an exception
        that it raises ends the wait.

    Raises
    ------
    MessageError
        If ROS knows no such domain or namespace.

    """

    def __init__(
        self,
        name: str,
        domain_id: int | None = None,
        namespace: str = '',
        *,
        patience: float = PATIENCE,
        keep_waiting: Callable[[str], None] = _keep_waiting,
    ) -> None:
        self._patience = patience
        self._keep_waiting = keep_waiting
        self._closed = False
        self._clients: dict[str, Client] = {}  # by the name of the service
        self.context = _join_domain(_validate_domain(domain_id))
        try:
            self.node = Node(
                name,
                namespace=namespace,
                context=self.context,
                use_global_arguments=False,
                start_parameter_services=False,
                enable_rosout=False,
            )
        except (NameValidationException, TypeError):
            raise MessageError(
                'namespace',
                'names of letters, digits and _, joined by /',
                repr(namespace),
            ) from None
        self._domain = f'ROS domain {self.context.get_domain_id()}'
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def __enter__(self: ClientT) -> ClientT:
        """Return the client itself."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Leave the graph."""
        self.close()

    def close(self) -> None:
        """Leave the graph; every call after the first does nothing."""
        if self._closed:
            return
        self._closed = True
        self._executor.shutdown()
        self.node.destroy_node()

    def _require_open(self) -> None:
        """Refuse work after `close`, for which there is no node."""
        if self._closed:
            raise RunError(
                f'{self._domain}: expected an open connection, got one that is closed; '
                'make another one'
            )

    def configure_and_activate(self, node_name: str) -> None:
        """Lead a node to the active state by the transitions that it still needs."""
        if self.get_state(node_name) == 'unconfigured':
            self.change_state(node_name, CONFIGURE)
        if self.get_state(node_name) == 'inactive':
            self.change_state(node_name, ACTIVATE)

    def change_state(self, node_name: str, transition: str) -> None:
        """
        Lead a node through a transition, e.g. `CONFIGURE`, unless it is there already.

        Raises
        ------
        TransitionError
            If the node is in another state than the goal afterwards.
        NoAnswerError
            If there is no such node.

        """
        request = ChangeState.Request(transition=Transition(label=transition))
        # Without an answer: it is lost, or the node is at work and answers later.
        with suppress(NoAnswerError):
            response = self.call_service(
                node_name, ChangeState, 'change_state', request, FIRST_TIMEOUT
            )
            if response.success:
                return
        if self.get_state(node_name) != GOALS[transition]:
            raise TransitionError(
                f'{node_name} refused to {transition}; its log says why'
            )

    def get_state(self, node_name: str) -> str:
        """Return the state of a node, e.g. 'inactive'; NoAnswerError after `patience`."""
        response = self.ask_service(
            node_name, GetState, 'get_state', GetState.Request()
        )
        return str(response.current_state.label)

    def has_lifecycle(self, node_name: str, wait: float) -> bool:
        """Return whether a node has a life cycle, looking for it for up to `wait` [s]."""
        client = self._get_client(node_name, GetState, 'get_state')
        return self._wait_until(client.service_is_ready, wait, f'{node_name} to appear')

    def _get_client(self, node_name: str, service: Any, name: str) -> Client:
        self._require_open()
        full_name = f'{node_name}/{name}'
        if full_name not in self._clients:
            self._clients[full_name] = self.node.create_client(service, full_name)
        return self._clients[full_name]

    def call_service(
        self,
        node_name: str,
        service: Any,
        name: str,
        request: Any,
        timeout: float = PATIENCE,
    ) -> Any:
        """
        Return the response of a service of a node.

        Parameters
        ----------
        node_name, service, name
            Name of the node, class of the service, and its name behind that of the node.
        request
            A request of that class.
        timeout
            Longest wait for the answer [s], once the service is there.

        Raises
        ------
        NoAnswerError
            If the service is not there within `patience`, or does not answer in time.

        """
        client = self._get_client(node_name, service, name)
        timeout = min(timeout, self._patience)
        if not self._wait_until(
            client.service_is_ready, self._patience, f'{node_name} to appear'
        ):
            raise NoAnswerError(
                f'{client.service_name}: expected this service within '
                f'{self._patience:g} s in {self._domain}, got none'
            )
        future = client.call_async(request)
        if not self._wait_until(future.done, timeout, f'{node_name} to answer'):
            client.remove_pending_request(future)
            raise NoAnswerError(
                f'{client.service_name}: expected an answer within {timeout:g} s, got none'
            )
        return future.result()

    def ask_service(self, node_name: str, service: Any, name: str, request: Any) -> Any:
        """
        Return the response of a service that changes nothing; see `call_service`.

        It is asked again every second: an answer may be lost, and a node that is killed and
        started again seems to listen at first, and never answers. NoAnswerError after `patience`.
        """
        give_up = time.monotonic() + self._patience
        while True:
            try:
                return self.call_service(node_name, service, name, request, ASK_PERIOD)
            except NoAnswerError:
                if time.monotonic() > give_up:
                    raise

    def get_parameters(self, node_name: str, *names: str) -> list[Any]:
        """Return the values of parameters of a node; RunError with the names that it lacks."""
        request = GetParameters.Request(names=names)
        response = self.ask_service(node_name, GetParameters, 'get_parameters', request)
        values = [parameter_value_to_python(value) for value in response.values]
        if len(values) != len(names) or None in values:
            self._require_known(node_name, names)
            raise RunError(
                f'{node_name}: expected the parameters {", ".join(names)}, got not all'
            )
        return values

    def set_parameters(self, node_name: str, values: Mapping[str, Any]) -> None:
        """
        Set parameters of a node by name, all or none.

        MessageError for a value that is none of a parameter; RunError, with the node's reason, if
        the node refuses.
        """
        changes = [_parameter_message(name, value) for name, value in values.items()]
        response = self.call_service(
            node_name,
            SetParametersAtomically,
            'set_parameters_atomically',
            SetParametersAtomically.Request(parameters=changes),
        )
        if not response.result.successful:
            # rclpy does not name a parameter that is not declared.
            self._require_known(node_name, values)
            raise RunError(str(response.result.reason))

    def _require_known(self, node_name: str, names: Iterable[str]) -> None:
        """Refuse names of parameters that a node does not have; RunError with all of them."""
        response = self.ask_service(
            node_name, ListParameters, 'list_parameters', ListParameters.Request()
        )
        unknown = [f"'{name}'" for name in names if name not in response.result.names]
        if unknown:
            raise RunError(
                f'{node_name}: expected parameters that it has, got {", ".join(unknown)}'
            )

    def _wait_until(
        self, condition: Callable[[], Any], timeout: float, what: str
    ) -> bool:
        """Return whether a condition came true in time; errors of `keep_waiting` go through."""
        give_up = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > give_up:
                return False
            self._keep_waiting(what)
            self._executor.spin_once(timeout_sec=SERVICE_PERIOD)
        return True


def _ignore_status(_status: ControllerStatus) -> None:
    """Take no note of a status."""


def _keep_message(kept: deque[Any], message: Any) -> None:
    """Keep a message; rclpy takes no built-in method, as `deque.append` is, for a callback."""
    kept.append(message)


class ControllerLink(ServiceClientNode):
    """
    One end of a connection to a running controller, without a thread.

    It keeps the newest message of each topic that it hears, and all of those that are `QUEUED`.

    Parameters
    ----------
    heard
        Topics to subscribe to, beside ~/status.
    namespace, domain_id
        Those of the controller; None for the domain of the environment.
    timeout
        Longest wait for an answer or a message [s].
    on_status
        Called with each status that `take_statuses` takes.

    Attributes
    ----------
    last_status
        The newest status that was taken, None before the first.

    """

    def __init__(
        self,
        heard: Sequence[Topic],
        *,
        namespace: str,
        domain_id: int | None,
        timeout: float,
        on_status: Callable[[ControllerStatus], None] = _ignore_status,
    ) -> None:
        super().__init__(
            f'multicontact_client_{os.getpid()}', domain_id, namespace, patience=timeout
        )
        self._on_status = on_status
        self.last_status: ControllerStatus | None = None
        self._kept: dict[Topic, deque[Any]] = {}
        self._subscriptions = {}
        for topic in (*heard, topics.STATUS):
            kept = deque[Any](maxlen=1)
            profile = qos.GLANCE
            if topic in QUEUED:
                kept = deque[Any]()
                profile = qos.STREAM
            elif topic.profile == qos.LATCHED:
                profile = qos.LATCHED
            self._kept[topic] = kept
            # The callback runs while a service is waited for; else messages are taken.
            self._subscriptions[topic] = self.node.create_subscription(
                topic.message, topic.name, partial(_keep_message, kept), profile
            )
        self._publishers = {
            topic: create_publisher(self.node, topic)
            for topic in (
                topics.FORCE_COMMAND,
                topics.MOTION_COMMAND,
                topics.TRAJECTORY_COMMAND,
            )
        }
        # Topics whose first command all readers have.
        self._connected: set[Topic] = set()

    def close(self) -> None:
        """Leave the graph once all readers of the commands have these."""
        if self._closed:
            return
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=CONNECTION_TIME))
        super().close()

    def _take_arrived(self, topic: Topic) -> deque[Any]:
        """Return the messages that are kept of a topic, with those that have just arrived."""
        self._require_open()
        kept = self._kept[topic]
        while (taken := take_message(self._subscriptions[topic])) is not None:
            message, _info = taken
            kept.append(message)
        return kept

    def get_newest(self, topic: Topic) -> Any | None:
        """Return the newest message of a topic, None if none has come so far."""
        kept = self._take_arrived(topic)
        return kept[-1] if kept else None

    def take_queued(self, topic: Topic) -> list[Any]:
        """Return the messages of a topic that have come since the last call, oldest first."""
        messages = list(self._take_arrived(topic))
        self._kept[topic].clear()
        return messages

    def receive_fresh(self, *wanted: Topic, one_stamp: bool = False) -> list[Any]:
        """
        Return a message of each topic that comes from now on.

        Parameters
        ----------
        wanted
            Topics that are heard.
        one_stamp
            Whether all messages are to be of one sample.

        Raises
        ------
        RunError
            If they do not come within the timeout.

        """

        def find_messages() -> list[Any] | None:
            messages: list[Any] = [self.get_newest(topic) for topic in wanted]
            if None in messages:
                return None
            first = messages[0].header.stamp
            if one_stamp and any(each.header.stamp != first for each in messages):
                return None
            return messages

        for topic in wanted:
            self._take_arrived(topic).clear()
        names = ', '.join(topic.name for topic in wanted)
        return self._await_value(find_messages, f'{names}: expected a message')

    def _await_value(self, get: Callable[[], T | None], missing: str) -> T:
        """Return the first value that is not None; RunError with a text if none comes in time."""
        give_up = time.monotonic() + self._patience
        while (value := get()) is None:
            if time.monotonic() > give_up:
                raise RunError(
                    f'{missing} within {self._patience:g} s in {self._domain}, got '
                    'none; is the controller active?'
                )
            time.sleep(MESSAGE_PERIOD)
        return value

    def take_statuses(self) -> list[ControllerStatus]:
        """Return what the controller has said of itself and of commands since the last call."""
        statuses = []
        for message in self.take_queued(topics.STATUS):
            self.last_status = ControllerStatus.from_message(message)
            statuses.append(self.last_status)
            self._on_status(self.last_status)
        return statuses

    def request_service(self, name: str, service: Any, request: Any) -> str:
        """
        Call a service of the controller, e.g. 'hold'; return what happens now, in words.

        CommandRefusedError with the controller's reason if it refuses.
        """
        answer = self.call_service(topics.CONTROLLER, service, name, request)
        if not answer.success:
            raise CommandRefusedError(
                f'{topics.CONTROLLER}: {name} refused: {answer.message}'
            )
        return str(answer.message)

    def publish_command(self, topic: Topic, command: Any, identifier: str) -> None:
        """Publish a command once, without waiting for an answer, which has its identifier."""
        self._require_open()
        set_identifier(command, identifier)
        self._publishers[topic].publish(command)

    def find_acceptance(self, identifier: str) -> ControllerStatus | None:
        """
        Return the newest acceptance of a command among the statuses since the last look.

        None if there is none so far. CommandRefusedError if the controller refuses it.
        """
        acceptance = None
        for status in self.take_statuses():
            if status.command != identifier:
                continue
            if status.event == REFUSED:
                raise CommandRefusedError(status.text)
            acceptance = status
        return acceptance

    def command_until_answered(self, topic: Topic, command: Any) -> ControllerStatus:
        """
        Publish a command until it is accepted, and return what the controller says then.

        A recorder may be connected later than the controller: the first command of a topic is
        then published for it again.

        Raises
        ------
        CommandRefusedError
            If the controller refuses the command.
        RunError
            If there is no answer within the timeout.

        """
        identifier = new_identifier()
        count_readers = self._publishers[topic].get_subscription_count
        resend_due = 0.0
        sent_to = 0  # readers

        def publish_and_look() -> ControllerStatus | None:
            nonlocal resend_due, sent_to
            # A command that is published before the connection stands is lost.
            if time.monotonic() >= resend_due:
                resend_due = time.monotonic() + RESEND_PERIOD
                sent_to = count_readers()
                self.publish_command(topic, command, identifier)
            return self.find_acceptance(identifier)

        def all_are_connected() -> bool:
            return count_readers() >= answer.readers

        answer = self._await_value(
            publish_and_look, f'{topic.name}: expected an answer'
        )
        if topic not in self._connected:
            self._connected.add(topic)
            if sent_to < answer.readers and self._wait_until(
                all_are_connected, CONNECTION_TIME, topic.name
            ):
                self.publish_command(topic, command, identifier)
        return answer
