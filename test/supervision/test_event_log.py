"""What the log writes can be read again."""

from multicontact_control.supervision.event_log import CAPACITY, EventLog, read_event
from multicontact_control.supervision.status import SupervisorStatus
import numpy as np


def status(reaction='none', causes=(), limits=(), states=('holding', 'given up')):
    return SupervisorStatus(
        reaction, causes, (), limits, states, np.zeros(2), np.zeros(2), 0.0)


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
