"""The topics and services by which a user commands the controller."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from multicontact_control.control_loop import ControlLoop
from multicontact_control.errors import MulticontactError
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.controller_config import ControllerNodeConfig
from multicontact_control.nodes.controller_events import ControllerEvents
from multicontact_control.nodes.graph_node import Refusals
from multicontact_control.nodes.status_message import identifier_of
from rclpy.node import Node
from rclpy.subscription import Subscription
from std_srvs.srv import SetBool, Trigger


class Service(NamedTuple):
    """A service of the controller's node: its name in it, class, and content for the reference."""

    name: str
    kind: Any
    content: str

    @property
    def type_name(self) -> str:
        """Return the type as ROS tools write it, e.g. ``std_srvs/srv/Trigger``."""
        return '/'.join([*self.kind.__module__.split('.')[:2], self.kind.__name__])


TARE = Service(
    'tare', Trigger, 'Takes the present reading of the wrist sensor for its bias; refused while '
    'a contact is under force control, or pressed by a reaction.')
HOLD = Service('hold', SetBool, 'Holds the present pose and forces, or lets go of them.')
RETRY = Service(
    'retry', Trigger, 'Resumes control that waits for an operator (cause `latched`), and seeks '
    'contacts that were given up.')
PUSH_TEST = Service(
    'push_test', Trigger, 'Begins the push test: log, diagnostics and `~/status` say where to '
    'push the tool.')

SERVICES: tuple[Service, ...] = (TARE, HOLD, RETRY, PUSH_TEST)


class CommandInterface:
    """
    Hands commands to a control loop, counts what it refuses, and answers.

    `set_bias` makes a bias of the wrist sensor the one in force; it may raise
    `MulticontactError`.
    """

    def __init__(
        self, node: Node, loop: ControlLoop, refusals: Refusals, events: ControllerEvents,
        set_bias: Callable[[list[float]], None],
    ) -> None:
        self._node, self._loop, self._set_bias = node, loop, set_bias
        self._refusals, self._events = refusals, events
        self._config = ControllerNodeConfig()
        self.subscriptions: dict[topics.Topic, Subscription] = {
            topic: node.create_subscription(topic.message, topic.name, callback, qos.COMMAND)
            for topic, callback in ((topics.FORCE_COMMAND, self._on_forces),
                                    (topics.MOTION_COMMAND, self._on_motion))}
        self._services = [
            self._service(service, work) for service, work in (
                (TARE, self._tare), (HOLD, self._hold), (RETRY, lambda _: loop.retry()),
                (PUSH_TEST, self._push_test))]

    def adopt(self, config: ControllerNodeConfig) -> None:
        """Tare and test as a configuration says."""
        self._config = config

    def close(self) -> None:
        """Free the topics and services."""
        for subscription in self.subscriptions.values():
            self._node.destroy_subscription(subscription)
        for service in self._services:
            self._node.destroy_service(service)

    def _on_forces(self, message: Any) -> None:
        self._obey(topics.FORCE_COMMAND, message, lambda: self._loop.set_forces(
            *messages.read_force_command(message, self._loop.config.column_names)))

    def _on_motion(self, message: Any) -> None:
        self._obey(topics.MOTION_COMMAND, message,
                   lambda: self._loop.set_motion(messages.read_motion(message)))

    def _obey(self, topic: topics.Topic, message: Any, work: Callable[[], None]) -> None:
        refusal = None
        try:
            work()
        except MulticontactError as error:
            self._refusals.refuse(topic.name, error)
            refusal = error
        self._events.answer(topic.name, identifier_of(message), refusal)

    def _tare(self, _request: Any) -> str:
        bias = self._loop.tare(self._config.tare)
        self._set_bias(bias.tolist())
        return 'bias [N, N m]: ' + ', '.join(f'{x:.4g}' for x in bias)

    def _hold(self, request: Any) -> str:
        self._loop.hold(request.data)
        return 'held' if request.data else 'released'

    def _push_test(self, _request: Any) -> str:
        return self._loop.push_test(self._config.push_test, self._config.push_point_sensor)

    def _service(self, service: Service, work: Callable[[Any], str]) -> Any:
        """Create a service that answers with the words of some work, or with why it is refused."""
        name = f'~/{service.name}'

        def answer(request: Any, response: Any) -> Any:
            try:
                response.message, response.success = work(request), True
            except MulticontactError as error:
                self._refusals.refuse(name, error)
                self._events.answer(name, error=error)
                response.message, response.success = str(error), False
            return response
        return self._node.create_service(service.kind, name, answer)
