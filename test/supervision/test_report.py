"""What a run keeps of its reactions."""

from multicontact_control.supervision.report import (
    EVENT_CAPACITY,
    EventLog,
    SupervisorStatus,
)
import pytest


def test_log_keeps_what_came_last():
    """The cause of the end, and not the beginning of a long run."""
    log = EventLog()
    for k in range(EVENT_CAPACITY + 5):
        log.note_status(0.002 * k, SupervisorStatus('none', (f'cause_{k}',)))
    assert len(log.events) == EVENT_CAPACITY
    assert log.events[0] == (pytest.approx(0.01), 'none | cause_5 | ')
    assert f'cause_{EVENT_CAPACITY + 4}' in log.events[-1][1]
    assert log.reaction_counts['none'] == EVENT_CAPACITY + 5
