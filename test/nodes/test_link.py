"""Guests of the graph: one participant for all of a process, which leaves with the last."""

import os
from pathlib import Path
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ElementTree

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
        check_guests(own, domain_id)


def check_guests(own, another):
    keeper = GuestNode('first', own)
    other, elsewhere = GuestNode('second', own), GuestNode('third', another)
    assert other.context is keeper.context is not elsewhere.context
    elsewhere.close()
    other.close()
    assert keeper.context.ok()
    assert 'first' in keeper.node.get_node_names()
    keeper.close()
    assert not keeper.context.ok()
    again = GuestNode('first', own)
    assert again.context.ok()
    assert again.context is not keeper.context
    again.close()


def test_short_cut_between_participants_of_a_process_is_off_unless_the_user_decides():
    """Fast DDS reads the file at the first participant; see `config/fastdds.xml`."""
    show = (
        'import os\nfrom multicontact_control.nodes.runtime import prepare_environment\n'
        'prepare_environment()\nprint(os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"])')
    environment = {name: value for name, value in os.environ.items()
                   if name != 'FASTRTPS_DEFAULT_PROFILES_FILE'}
    for chosen in ({}, {'FASTRTPS_DEFAULT_PROFILES_FILE': '/my/own.xml'}):
        said = subprocess.run([sys.executable, '-c', show], env={**environment, **chosen},
                              capture_output=True, text=True, check=True).stdout.split()[-1]
        if chosen:
            assert said == '/my/own.xml'
        else:
            file = ElementTree.fromstring(Path(said).read_text(encoding='utf-8'))
            assert [setting.text for setting in file.iter()
                    if setting.tag.endswith('intraprocess_delivery')] == ['OFF']


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
    monkeypatch.setattr(link, 'FIRST_TIMEOUT', 0.3)
    node = Slow(domain_id, 1.5, tells)
    try:
        with LifecycleDriver(domain_id) as driver:
            driver.change('slow', CONFIGURE)
            assert node.state == 'inactive'
            assert not tells or node.requests == 1
            with pytest.raises(TransitionError, match='slow refused to activate'):
                driver.change('slow', ACTIVATE)
    finally:
        node.close()
