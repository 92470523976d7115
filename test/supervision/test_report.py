"""What a run keeps of its reactions."""

from multicontact_control.supervision.report import CAPACITY, EventLog, SupervisorStatus
import pytest


def test_log_keeps_what_came_last():
    """The cause of the end, and not the beginning of a long run."""
    log = EventLog()
    for k in range(CAPACITY + 5):
        log.note(0.002 * k, SupervisorStatus('none', (f'cause_{k}',)))
    assert len(log.events) == CAPACITY
    assert log.events[0] == (pytest.approx(0.01), 'none | cause_5 | ')
    assert f'cause_{CAPACITY + 4}' in log.events[-1][1]
    assert log.reactions['none'] == CAPACITY + 5
