"""What the log writes can be read again."""

from multicontact_control.experiment.judge import read_event
from multicontact_control.supervision.report import CAPACITY, EventLog, SupervisorStatus


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


def test_log_keeps_the_first_events():
    log = EventLog()
    for k in range(CAPACITY + 7):
        log.note(0.002 * k, status(states=(str(k),)))
    assert len(log.events) == CAPACITY and read_event(*log.events[0]).contact_states == ('0',)
