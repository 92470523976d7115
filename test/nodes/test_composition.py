"""Nodes of one process: who is called, when, and with what."""

import gc

from multicontact_control.nodes.composition import Composition
from multicontact_control.nodes.local_delivery import LocalDelivery
from multicontact_control.nodes.managed_node import SUCCESS
from multicontact_control.nodes.noise_estimator_node import NoiseEstimatorNode
from multicontact_control.paths import config_dir
import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions


def test_messages_are_delivered_in_order_and_not_from_within():
    local, seen = LocalDelivery(['a', 'b']), []

    def answer(data):
        seen.append(data)
        if len(data) < 3:
            local.send('/back', data + b'.')
            seen.append('sent')

    ends = [local.subscribe('/there', answer), local.subscribe('/back', answer)]
    local.send('/there', b'x')
    local.send('/there', b'y')
    assert seen == []
    assert local.deliver()
    assert seen == [b'x', 'sent', b'y', 'sent', b'x.', 'sent', b'y.', 'sent', b'x..', b'y..']
    assert not local.deliver()
    ends[0].close()
    local.send('/there', b'z')
    assert not local.deliver()
    assert (local.readers('/there'), local.readers('/back')) == (0, 1)


class Passenger:
    def __init__(self):
        self.turns = 0

    def turn(self, spinner):
        self.turns += 1
        spinner.take_turns(spinner)  # as a node does that spins while it looks

    def longest_wait(self):
        return 0.02


def test_turns_do_not_go_in_circles():
    passengers = [Passenger(), Passenger()]
    nodes = Composition(None, passengers)
    nodes.take_turns(nodes)
    nodes.take_turns(nodes)
    assert [x.turns for x in passengers] == [2, 2]
    assert nodes.longest_wait(0.1) == 0.02
    assert nodes.longest_wait(0.001) == 0.001


class Ending:
    def __init__(self, log, name, fails):
        self._log, self._name, self._fails = log, name, fails

    def close(self):
        self._log.append(f'close {self._name}')
        if self._fails:
            raise OSError(self._name)

    def destroy_node(self):
        self._log.append(f'destroy {self._name}')


def test_all_nodes_are_closed_whatever_becomes_of_one():
    log = []
    nodes = Composition(Ending(log, 'a', True), [Ending(log, 'b', False)])
    with pytest.raises(OSError, match='a'):
        nodes.close()
    assert sorted(log) == ['close a', 'close b', 'destroy a', 'destroy b']


@pytest.fixture
def estimators(domain_id, tmp_path, monkeypatch):
    """Two managed nodes in this process."""
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'ros'))
    rclpy.init(args=['--ros-args', '--params-file', str(config_dir() / 'noise_estimator.yaml')],
               domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
    nodes = [NoiseEstimatorNode(), NoiseEstimatorNode()]
    try:
        yield nodes
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
        gc.enable()
        gc.unfreeze()


@pytest.mark.ros
def test_no_heap_is_collected_for_a_node_while_another_works(estimators):
    first, second = estimators
    collections = []

    def note(phase, info):
        collections.append((phase, info['generation']))

    def collected(*transitions):
        collections.clear()
        assert [trigger() for trigger in transitions] == [SUCCESS] * len(transitions)
        return ('start', 2) in collections

    gc.callbacks.append(note)
    try:
        assert collected(first.trigger_configure)
        assert collected(second.trigger_configure)
        assert not collected(first.trigger_activate, second.trigger_cleanup)
        assert not collected(second.trigger_configure)
        assert collected(first.trigger_deactivate, first.trigger_cleanup)
    finally:
        gc.callbacks.remove(note)
