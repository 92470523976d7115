"""Guests of a graph: one participant for all, and transitions that take long."""

from __future__ import annotations

import threading
import time

from lifecycle_msgs.srv import ChangeState, GetState
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.nodes import link
from multicontact_control.nodes.link import (
    ACTIVATE,
    CONFIGURE,
    GuestNode,
    LifecycleDriver,
    TransitionError,
)
import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor

pytestmark = pytest.mark.ros


def test_guests_of_a_domain_are_one_participant_until_the_last_has_left(domain_id, monkeypatch):
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    with reserve_domain() as own:
        first, second = GuestNode('first', own), GuestNode('second', own)
        elsewhere = GuestNode('third', domain_id)
        assert second.context is first.context is not elsewhere.context
        elsewhere.close()
        second.close()
        assert first.context.ok() and 'first' in first.node.get_node_names()
        first.close()
        assert not first.context.ok()
        with GuestNode('first', own) as again:
            assert again.context.ok() and again.context is not first.context


class Slow:
    """
    A node that takes longer for its transitions than an answer is waited for.

    Meanwhile it tells that it is at it, or what was before, as one does whose queue has the
    question for its state before the transition.
    """

    def __init__(self, domain_id, duration, tells):
        self.requests, self.duration, self.tells = 0, duration, tells
        self.state, self._lock = 'unconfigured', threading.Lock()
        self._guest = GuestNode('slow', domain_id)
        for service, name, callback in (
                (GetState, 'get_state', self._get), (ChangeState, 'change_state', self._change)):
            self._guest.node.create_service(
                service, f'~/{name}', callback, callback_group=ReentrantCallbackGroup())
        self._executor = MultiThreadedExecutor(4, context=self._guest.context)
        self._executor.add_node(self._guest.node)
        self._thread = threading.Thread(target=self._executor.spin)
        self._thread.start()

    def _get(self, _request, response):
        response.current_state.label = self.state
        return response

    def _change(self, request, response):
        self.requests += 1
        with self._lock:
            response.success = self.state == 'unconfigured' and (
                request.transition.label == CONFIGURE)
            if response.success:
                self.state = 'configuring' if self.tells else self.state
                time.sleep(self.duration)
                self.state = 'inactive'
        return response

    def close(self):
        self._executor.shutdown()
        self._thread.join()
        self._guest.close()


@pytest.mark.parametrize('tells', [True, False])
def test_transition_that_takes_long_is_not_refused_for_being_asked_for_twice(
        domain_id, monkeypatch, tells):
    monkeypatch.setattr(link, 'FIRST_TIMEOUT', 0.2)
    node = Slow(domain_id, 0.8, tells)
    try:
        with LifecycleDriver(domain_id) as driver:
            driver.change('slow', CONFIGURE)
            assert node.state == 'inactive'
            assert not tells or node.requests == 1
            with pytest.raises(TransitionError):
                driver.change('slow', ACTIVATE)
    finally:
        node.close()
