"""One end of a connection to a running controller: its topics, services and lifecycle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import os
import time
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from multicontact_control.errors import RunError
from multicontact_control.nodes import qos
from multicontact_control.nodes.graph_node import create_publisher
from multicontact_control.nodes.guest import GuestNode
from multicontact_control.nodes.topics import Topic
from rclpy.executors import SingleThreadedExecutor
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

POLL_PERIOD = 0.001


class ControllerLink:
    """
    A node in a context of its own, without a thread.

    Subscriptions hold the newest message and are looked at when one is wanted; only services
    need an executor, for the time of a call.

    Parameters
    ----------
    topics
        What to listen to.
    namespace, domain_id
        Where the controller is.
    timeout
        Longest wait for anything [s].

    """

    def __init__(
        self, topics: Sequence[Topic], *, namespace: str, domain_id: int | None, timeout: float,
    ) -> None:
        self._timeout = timeout
        self._guest = GuestNode(f'multicontact_client_{os.getpid()}', domain_id, namespace)
        self._node = self._guest.node
        self._newest: dict[Topic, Any] = {}
        self._subscriptions: dict[Topic, Subscription] = {
            topic: self._node.create_subscription(
                topic.message, topic.name, self._keep(topic), qos.GLANCE)
            for topic in topics}

    def _keep(self, topic: Topic) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            self._newest[topic] = message
        return keep

    def close(self) -> None:
        """Leave the graph."""
        self._guest.close()

    def publisher(self, topic: Topic) -> Publisher:
        """Return a publisher of a command."""
        return create_publisher(self._node, topic)

    def publish(self, publisher: Publisher, message: Any) -> None:
        """
        Publish a command once a controller listens.

        Raises
        ------
        RunError
            If none does.

        """
        give_up = time.monotonic() + self._timeout
        while publisher.get_subscription_count() == 0:
            if time.monotonic() > give_up:
                raise RunError(
                    f'{publisher.topic_name}: expected a controller that listens within '
                    f'{self._timeout:g} s, found none (with a reference file it does not)')
            time.sleep(POLL_PERIOD)
        publisher.publish(message)

    def fresh(self, *topics: Topic) -> list[Any]:
        """
        Return a message of each topic that comes from now on.

        Raises
        ------
        RunError
            If none comes.

        """
        for topic in topics:
            self._take(topic)
            self._newest.pop(topic, None)
        return [self._wait_for(topic) for topic in topics]

    def newest(self, topic: Topic) -> Any | None:
        """Return the newest message of a topic, None if none has come so far."""
        self._take(topic)
        return self._newest.get(topic)

    def _wait_for(self, topic: Topic) -> Any:
        give_up = time.monotonic() + self._timeout
        while topic not in self._newest:
            self._take(topic)
            if topic in self._newest:
                break
            if time.monotonic() > give_up:
                raise RunError(f'{topic.name}: expected a message within {self._timeout:g} s, '
                               'found none; is the controller active?')
            time.sleep(POLL_PERIOD)
        return self._newest[topic]

    def _take(self, topic: Topic) -> None:
        """Look for a message; no executor is needed for that."""
        handle = self._subscriptions[topic].handle
        with handle:
            while (taken := handle.take_message(topic.message, False)) is not None:
                self._newest[topic] = taken[0]

    def call(self, service: Any, name: str, request: Any) -> Any:
        """
        Call a service and return its answer.

        Raises
        ------
        RunError
            If there is no such service, or no answer.

        """
        full = self._node.resolve_service_name(name)
        client = self._node.create_client(service, name)
        executor = SingleThreadedExecutor(context=self._guest.context)
        executor.add_node(self._node)
        try:
            if not client.wait_for_service(timeout_sec=self._timeout):
                raise RunError(f'{full}: expected this service within '
                               f'{self._timeout:g} s, found none')
            future = client.call_async(request)
            executor.spin_until_future_complete(future, timeout_sec=self._timeout)
            if not future.done():
                raise RunError(
                    f'{full}: expected an answer within {self._timeout:g} s')
            return future.result()
        finally:
            executor.remove_node(self._node)
            executor.shutdown()
            self._node.destroy_client(client)

    def has_lifecycle(self, node_name: str, wait: float) -> bool:
        """Return whether a node has a lifecycle, looking for it for up to `wait` [s]."""
        client = self._node.create_client(GetState, f'{node_name}/get_state')
        found = bool(client.wait_for_service(timeout_sec=wait))
        self._node.destroy_client(client)
        return found

    def bring_up(self, node_name: str) -> bool:
        """
        Configure and activate a node, as far as it is not; return whether it was not active.

        Raises
        ------
        RunError
            If it has no lifecycle, does not answer or refuses.

        """
        if self._lifecycle_state(node_name) == State.PRIMARY_STATE_UNCONFIGURED:
            self._change_state(node_name, Transition.TRANSITION_CONFIGURE, 'configure')
        inactive = self._lifecycle_state(node_name) == State.PRIMARY_STATE_INACTIVE
        if inactive:
            self._change_state(node_name, Transition.TRANSITION_ACTIVATE, 'activate')
        return inactive

    def take_down(self, node_name: str) -> None:
        """
        Deactivate a node if it is active.

        Raises
        ------
        RunError
            If it has no lifecycle, does not answer or refuses.

        """
        if self._lifecycle_state(node_name) == State.PRIMARY_STATE_ACTIVE:
            self._change_state(node_name, Transition.TRANSITION_DEACTIVATE, 'deactivate')

    def _lifecycle_state(self, node_name: str) -> int:
        answer = self.call(GetState, f'{node_name}/get_state', GetState.Request())
        return int(answer.current_state.id)

    def _change_state(self, node_name: str, transition: int, label: str) -> None:
        request = ChangeState.Request(transition=Transition(id=transition, label=label))
        if not self.call(ChangeState, f'{node_name}/change_state', request).success:
            raise RunError(f'{node_name}: refused to {label}; its log says why')
