"""Guests of a graph: one participant for all, and transitions that take long."""

from __future__ import annotations

import gc
import os
from pathlib import Path
import threading
import time

from lifecycle_msgs.srv import ChangeState, GetState
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.nodes import link
from multicontact_control.nodes.link import (
    ACTIVATE,
    CONFIGURE,
    GuestNode,
    TransitionError,
)
import pytest
from rclpy.executors import SingleThreadedExecutor

pytestmark = pytest.mark.ros


def sockets():
    """Return how many sockets this process has, without those of nodes that are garbage."""
    gc.unfreeze()
    gc.collect()
    return sum(os.readlink(each).startswith('socket:') for each in Path('/proc/self/fd').iterdir()
               if each.is_symlink())


def test_guests_of_a_domain_are_one_participant_until_the_last_has_left(domain_id, monkeypatch):
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    with reserve_domain() as own:
        before = sockets()
        with GuestNode('first', own) as first:
            with GuestNode('second', own) as second, GuestNode('third', domain_id) as elsewhere:
                assert second.context is first.context is not elsewhere.context
            assert 'first' in first.node.get_node_names() and sockets() > before
        assert sockets() == before
        with GuestNode('first', own) as again:
            assert again.context.ok() and 'first' in again.node.get_node_names()


def test_transition_that_takes_long_is_waited_for(domain_id, monkeypatch):
    """The node at work answers neither this request nor the question for its state meanwhile."""
    monkeypatch.setattr(link, 'FIRST_TIMEOUT', 0.2)
    states = ['unconfigured']

    def change(request, response):
        response.success = states[-1] == 'unconfigured' and request.transition.label == CONFIGURE
        if response.success:
            time.sleep(0.8)
            states.append('inactive')
        return response

    def get(_request, response):
        response.current_state.label = states[-1]
        return response

    with GuestNode('slow', domain_id) as slow, GuestNode('driver', domain_id) as driver:
        slow.node.create_service(GetState, '~/get_state', get)
        slow.node.create_service(ChangeState, '~/change_state', change)
        executor = SingleThreadedExecutor(context=slow.context)
        executor.add_node(slow.node)
        thread = threading.Thread(target=executor.spin)
        thread.start()
        try:
            driver.change('slow', CONFIGURE)
            assert states == ['unconfigured', 'inactive']
            with pytest.raises(TransitionError):
                driver.change('slow', ACTIVATE)
        finally:
            executor.shutdown()
            thread.join()
