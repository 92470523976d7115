"""What the log writes can be read again."""

from multicontact_control.supervision.report import (
    CAPACITY,
    EventLog,
    read_event,
    SupervisorStatus,
)
import pytest


def status(reaction='none', causes=(), limits=(), states=('holding', 'given up')):
    return SupervisorStatus(reaction, causes, (), limits, states, 0.0)


def test_an_event_is_read_as_it_was_written():
    log = EventLog()
    log.note(1.5, status('hold', ('wrench_stale', 'motion_joint_speed'), ('joint', 'torque_rate')))
    log.note(2.0, status(limits=('reference',)))
    first, second = (read_event(*event) for event in log.events)
    assert first == (1.5, 'hold', ('wrench_stale', 'motion_joint_speed'),
                     ('joint', 'torque_rate'), ('holding', 'given up'))
    assert second == (2.0, 'none', (), ('reference',), ('holding', 'given up'))


def test_log_that_is_full_counts_what_it_drops():
    log = EventLog()
    for k in range(CAPACITY + 7):
        log.note(0.002 * k, status(states=(str(k),)))
    assert (len(log.events), log.dropped) == (CAPACITY, 7)


def test_what_changes_more_than_twice_a_second_alternates():
    log = EventLog(['table', 'board'])
    for k in range(100):
        held = 'lost' if k % 3 == 0 else 'holding'
        log.note(0.1 * k, status('hold' if k % 20 == 0 else 'none', states=(held, 'holding')))
    rates = log.alternating(9.9)
    assert list(rates) == ['table']
    assert rates['table'] == pytest.approx(6.7, abs=0.3)
    assert log.alternating(30.0) == {}
