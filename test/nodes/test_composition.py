"""Nodes of one process: who is called, when, and with what."""

from multicontact_control.nodes.composition import Composition
from multicontact_control.nodes.local_delivery import LocalDelivery
import pytest


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
