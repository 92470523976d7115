"""A process that is none of the graph's takes part in it: a node of its own, services, topics."""

from __future__ import annotations

import atexit
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
import os
import time
from typing import Any, Self, TypeVar

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
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

CONFIGURE, ACTIVATE, DEACTIVATE, CLEAN_UP = (
    'configure',
    'activate',
    'deactivate',
    'cleanup',
)
GOALS = {
    CONFIGURE: 'inactive',
    ACTIVATE: 'active',
    DEACTIVATE: 'inactive',
    CLEAN_UP: 'unconfigured',
}
LARGEST_DOMAIN = 232  # for which there are ports
PATIENCE = 300.0  # s, until a node is there, and has done its work
FIRST_TIMEOUT = 5.0  # s; an answer may be lost: then the state tells
ASK_PERIOD = 1.0  # s
QUEUED = (topics.STATUS, topics.DIAGNOSTICS)  # of which no message may be missed
RESEND_PERIOD = 0.2  # s, of a command that is not answered
CONNECTION_TIME = 2.0  # s, that the first command waits for all its readers at most
WAIT_PERIOD, POLL_PERIOD = 0.02, 0.001  # s, for services, and for messages

T = TypeVar('T')


class CommandRefusedError(RunError):
    """The controller refuses a command, and says why."""


class NoAnswerError(RunError):
    """A node does not answer."""


class TransitionError(RunError):
    """A node refused a transition; its log says why."""


@cache
def _context(domain_id: int) -> Context:
    """Return the context of all guests of a domain: one participant, as long as it has nodes."""
    # Fast DDS 2.14 can wait for itself for ever when one leaves while others come and go.
    context = Context()
    start_ros([], context=context, domain_id=domain_id)
    atexit.register(context.try_shutdown)
    return context


def _domain_number(domain_id: int | None) -> int:
    """Return the number of a ROS domain, by default that of the environment; MessageError."""
    given: object = domain_id
    if given is None:
        given = os.environ.get('ROS_DOMAIN_ID') or '0'
    number = -1
    if isinstance(given, int):
        number = given
    elif isinstance(given, str) and given.isdecimal():
        number = int(given)
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


class ServiceClientNode:
    """
    A node without parameters and logs, which calls services and transitions of others.

    The domain is that of the environment by default. It waits up to `patience` [s] for a node to
    appear or work; `keep_waiting` is called with what is waited for meanwhile, and may raise.
    """

    def __init__(
        self,
        name: str,
        domain_id: int | None = None,
        namespace: str = '',
        *,
        patience: float = PATIENCE,
        keep_waiting: Callable[[str], None] = lambda what: None,
    ) -> None:
        self._patience, self._keep_waiting = patience, keep_waiting
        self._closed = False
        self.context = _context(_domain_number(domain_id))
        try:
            self.node = node = Node(
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
        self._client = cache(
            lambda server, service, name: node.create_client(
                service, f'{server}/{name}'
            )
        )
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def __enter__(self) -> Self:
        """Return the guest itself."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Leave the graph."""
        self.close()

    def close(self) -> None:
        """Leave the graph, once."""
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
        """Configure and activate a node, as far as it is not."""
        for state, transition in (('unconfigured', CONFIGURE), ('inactive', ACTIVATE)):
            if self.get_state(node_name) == state:
                self.change_state(node_name, transition)

    def change_state(self, node_name: str, transition: str) -> None:
        """Lead a node to where a transition goes; TransitionError if it refuses, NoAnswerError."""
        request = ChangeState.Request(transition=Transition(label=transition))
        with suppress(
            NoAnswerError
        ):  # it is lost, or the node is at work and answers later
            if self.call_service(
                node_name, ChangeState, 'change_state', request, FIRST_TIMEOUT
            ).success:
                return
        if self.get_state(node_name) != GOALS[transition]:
            raise TransitionError(
                f'{node_name} refused to {transition}; its log says why'
            )

    def get_state(self, node_name: str) -> str:
        """Return the state of a node; NoAnswerError."""
        give_up = time.monotonic() + self._patience
        while (
            True
        ):  # one that is killed and started again seems to listen, and never answers
            try:
                return str(
                    self.call_service(
                        node_name, GetState, 'get_state', GetState.Request(), ASK_PERIOD
                    ).current_state.label
                )
            except NoAnswerError:
                if time.monotonic() > give_up:
                    raise

    def has_lifecycle(self, node_name: str, wait: float) -> bool:
        """Return whether a node has a lifecycle, looking for it for up to `wait` [s]."""
        self._require_open()
        return self._wait_until(
            self._client(node_name, GetState, 'get_state').service_is_ready,
            wait,
            f'{node_name} to appear',
        )

    def call_service(
        self,
        node_name: str,
        service: Any,
        name: str,
        request: Any,
        timeout: float = PATIENCE,
    ) -> Any:
        """Return the response of a service; NoAnswerError without one within `timeout` [s]."""
        self._require_open()
        client, timeout = (
            self._client(node_name, service, name),
            min(timeout, self._patience),
        )
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

    def get_parameters(self, node_name: str, *names: str) -> list[Any]:
        """Return parameters of a node; RunError if it lacks one."""
        request = GetParameters.Request(names=names)
        values = [
            *map(
                parameter_value_to_python,
                self.call_service(
                    node_name, GetParameters, 'get_parameters', request
                ).values,
            )
        ]
        if len(values) != len(names) or None in values:
            self._require_known(node_name, names)
            raise RunError(
                f'{node_name}: expected the parameters {", ".join(names)}, got not all'
            )
        return values

    def set_parameters(self, node_name: str, values: Mapping[str, Any]) -> None:
        """Set parameters of a node, all or none; RunError if it refuses."""
        request = SetParametersAtomically.Request(
            parameters=[
                _parameter_message(name, value) for name, value in values.items()
            ]
        )
        result = self.call_service(
            node_name, SetParametersAtomically, 'set_parameters_atomically', request
        ).result
        if not result.successful:
            self._require_known(
                node_name, values
            )  # rclpy names none that is not declared
            raise RunError(str(result.reason))

    def _require_known(self, node_name: str, names: Iterable[str]) -> None:
        """Refuse names of parameters that a node does not have; RunError with all of them."""
        known = self.call_service(
            node_name, ListParameters, 'list_parameters', ListParameters.Request()
        ).result.names
        unknown = [f"'{name}'" for name in names if name not in known]
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
            self._executor.spin_once(timeout_sec=WAIT_PERIOD)
        return True


class ControllerLink(ServiceClientNode):
    """
    One end of a connection to a running controller, without a thread.

    It keeps the newest message of each topic that it hears, all of those `QUEUED`, and waits for
    nothing longer than `timeout` [s]. `on_status` is called with each status that `look` takes,
    of which `last_status` is the last.
    """

    def __init__(
        self,
        heard: Sequence[Topic],
        *,
        namespace: str,
        domain_id: int | None,
        timeout: float,
        on_status: Callable[[ControllerStatus], None] = lambda status: None,
    ) -> None:
        super().__init__(
            f'multicontact_client_{os.getpid()}', domain_id, namespace, patience=timeout
        )
        self._on_status = on_status
        self.last_status: ControllerStatus | None = None
        self._kept: dict[Topic, deque[Any]] = {
            topic: deque(maxlen=None if topic in QUEUED else 1)
            for topic in (*heard, topics.STATUS)
        }
        self._subscriptions = {
            topic: self.node.create_subscription(
                topic.message,
                topic.name,
                lambda message, kept=kept: kept.append(
                    message
                ),  # while a service is waited for
                qos.STREAM
                if kept.maxlen is None
                else qos.LATCHED
                if topic.profile == qos.LATCHED
                else qos.GLANCE,
            )
            for topic, kept in self._kept.items()
        }
        self._publishers = {
            topic: create_publisher(self.node, topic)
            for topic in (topics.FORCE_COMMAND, topics.MOTION_COMMAND)
        }
        self._connected: set[Topic] = (
            set()
        )  # those whose first command all readers have

    def close(self) -> None:
        """Leave the graph, when all readers of the commands have these."""
        if self._closed:
            return
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=CONNECTION_TIME))
        super().close()

    def _take_arrived(self, topic: Topic) -> deque[Any]:
        self._require_open()
        kept = self._kept[topic]
        while (taken := take_message(self._subscriptions[topic])) is not None:
            kept.append(taken[0])
        return kept

    def get_newest(self, topic: Topic) -> Any | None:
        """Return the newest message of a topic, None if none has come so far."""
        return next(reversed(self._take_arrived(topic)), None)

    def take_queued(self, topic: Topic) -> list[Any]:
        """Return the messages of a topic that have come since this was called last."""
        messages = list(self._take_arrived(topic))
        self._kept[topic].clear()
        return messages

    def receive_fresh(self, *wanted: Topic, one_stamp: bool = False) -> list[Any]:
        """Return messages that come from now on, all of one stamp if asked to; RunError."""

        def complete() -> list[Any] | None:
            messages: list[Any] = [self.get_newest(topic) for topic in wanted]
            stamps = [x and x.header.stamp for x in messages]
            return (
                None
                if None in stamps
                or (one_stamp and stamps.count(stamps[0]) < len(stamps))
                else messages
            )

        for topic in wanted:
            self._take_arrived(topic).clear()
        return self._await_value(
            complete, f'{", ".join(topic.name for topic in wanted)}: expected a message'
        )

    def _await_value(self, get: Callable[[], T | None], missing: str) -> T:
        give_up = time.monotonic() + self._patience
        while (value := get()) is None:
            if time.monotonic() > give_up:
                raise RunError(
                    f'{missing} within {self._patience:g} s in {self._domain}, got '
                    'none; is the controller active?'
                )
            time.sleep(POLL_PERIOD)
        return value

    def take_statuses(self) -> list[ControllerStatus]:
        """Return what the controller has said of itself and of commands since the last look."""
        statuses = [
            ControllerStatus.from_message(message)
            for message in self.take_queued(topics.STATUS)
        ]
        for self.last_status in statuses:
            self._on_status(self.last_status)
        return statuses

    def request_service(self, name: str, service: Any, request: Any) -> str:
        """Call a service of the controller; return what it says; CommandRefusedError."""
        answer = self.call_service(topics.CONTROLLER, service, name, request)
        if not answer.success:
            raise CommandRefusedError(
                f'{topics.CONTROLLER}: {name} refused: {answer.message}'
            )
        return str(answer.message)

    def publish_command(self, topic: Topic, command: Any, identifier: str) -> None:
        """Publish a command once, without waiting for an answer."""
        self._require_open()
        set_identifier(command, identifier)
        self._publishers[topic].publish(command)

    def find_acceptance(self, identifier: str) -> ControllerStatus | None:
        """Return the acceptance of a command since the last look, if any; CommandRefusedError."""
        answers = [
            status for status in self.take_statuses() if status.command == identifier
        ]
        for status in answers:
            if status.event == REFUSED:
                raise CommandRefusedError(status.text)
        return answers[-1] if answers else None

    def command_until_answered(self, topic: Topic, command: Any) -> ControllerStatus:
        """
        Publish a command until it is accepted, and return what the controller says then.

        CommandRefusedError if it refuses, RunError without an answer.

        A recorder may be connected later than the controller: the first command of a topic is
        then published for it again.
        """
        identifier, due, sent_to = new_identifier(), 0.0, 0
        readers = self._publishers[topic].get_subscription_count

        def publish_until_answered() -> ControllerStatus | None:
            nonlocal due, sent_to
            if (
                time.monotonic() >= due
            ):  # one that comes before the connection stands is lost
                due, sent_to = time.monotonic() + RESEND_PERIOD, readers()
                self.publish_command(topic, command, identifier)
            return self.find_acceptance(identifier)

        answer = self._await_value(
            publish_until_answered, f'{topic.name}: expected an answer'
        )
        if topic not in self._connected:
            self._connected.add(topic)
            if sent_to < answer.readers and self._wait_until(
                lambda: readers() >= answer.readers, CONNECTION_TIME, topic.name
            ):
                self.publish_command(topic, command, identifier)
        return answer
