"""One step of the supervisor: the time of the task, recovery, findings, what an answer tells."""

from multicontact_control.supervision.contacts import GIVEN_UP
import numpy as np
import pytest
from supervision.test_doubt import advance, make_loop
from supervision.test_recovery import pressing, with_wrench, without_wrench

H = 0.002
with_wrong_wrench = with_wrench(lambda wrench: np.nan * wrench)


def test_time_of_the_task_goes_on_with_samples_and_stands_still_in_a_reaction():
    with make_loop('rigid') as loop:
        supervisor = loop.control.supervisor
        start = supervisor.task_time
        advance(loop, 0.1)
        assert supervisor.task_time - start == pytest.approx(0.1)
        loop.act()  # a sample that the controller is not given
        advance(loop, 0.1)
        assert supervisor.task_time - start == pytest.approx(0.2 + H)
        advance(loop, 0.1, without_wrench)
        assert loop.status.reaction == 'hold'
        before = supervisor.task_time
        advance(loop, 0.02, without_wrench)
        assert supervisor.task_time == before


def test_good_samples_count_anew_after_each_bad_one():
    """50 ms of them in a row, at first; wrong ones are bridged for 24 ms, which are good."""
    with make_loop('rigid') as loop:
        advance(loop, 0.06, with_wrong_wrench)
        assert loop.status.reaction == 'hold'
        advance(loop, 0.02)
        assert loop.status.reaction == 'hold'
        advance(loop, 0.06, with_wrong_wrench)
        _, statuses = advance(loop, 0.04)
        assert {status.reaction for status in statuses} == {'hold'}
        advance(loop, 0.04)
        assert loop.status.reaction == 'none'


def fail(_):
    raise ZeroDivisionError('the mass of nothing')


def test_exception_that_comes_back_after_each_recovery_is_logged_once(
    monkeypatch, caplog
):
    with make_loop('rigid') as loop:
        monkeypatch.setattr(loop.control.supervisor.task, 'update_wanted_task', fail)
        _, statuses = advance(loop, 0.5)
    causes = [status.causes for status in statuses]
    assert causes.count(('law_ZeroDivisionError',)) > 1
    assert len(caplog.records) == 1


def test_findings_end_with_the_reaction_that_they_explain(monkeypatch):
    with make_loop('rigid') as loop:
        supervisor = loop.control.supervisor
        with monkeypatch.context() as patch:
            patch.setattr(supervisor.task, 'update_wanted_task', fail)
            advance(loop, 0.01)
        assert supervisor.findings
        advance(loop, 1.0)
        assert loop.status.reaction == 'none'
        assert supervisor.findings == ()


def test_force_law_answers_nothing_during_a_reaction():
    with pressing('rigid') as loop:
        assert loop.control.output.answer['active'].all()
        assert loop.control.output.answer['alpha_est'].all()
        advance(loop, 0.1, without_wrench)
        assert loop.status.reaction == 'hold'
        answer = loop.control.output.answer
        assert not answer['active'].any()
        assert not answer['alpha_est'].any()


def test_retry_tells_whether_anything_waited_for_it():
    with make_loop('rigid') as loop:
        supervisor = loop.control.supervisor
        assert not supervisor.request_retry()
        supervisor.task.states['state'][0] = GIVEN_UP
        assert supervisor.request_retry()
        assert supervisor.task.states['retry_requested'].tolist() == [True, False]
