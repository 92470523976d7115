"""What the machine did to a run is told from what the arm did."""

from multicontact_control.experiment.judge import judge
from multicontact_control.experiment.real_time import late_reactions, timeliness
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.verdict import NOT_STABLE, STABLE, UNJUDGED
from multicontact_control.supervision.event_log import CAPACITY, read_event
import numpy as np
import pytest
from synthetic_run import perfect_run

CALM = 'none |  | holding, holding'
LATE = 'hold | joints_stale wrench_stale | holding, holding'
RECOVERING = 'hold | recovering | holding, holding'
SIDEWAYS = 'hold | wrench_sideways | holding, holding'


@pytest.fixture(scope='module')
def setup():
    return resolve('quick', plant='rigid')


@pytest.fixture
def data(setup):
    return perfect_run(setup)


def events_of(*texts):
    return [read_event(time, what) for time, what in texts]


HELD_AT_5 = events_of((0.0, CALM), (5.0, LATE), (5.1, RECOVERING), (5.3, CALM))


def lose(data, start, lasting):
    data.alpha_true[round(start * 500.0):round((start + lasting) * 500.0), 1] = 0.0


def test_real_time_is_kept_up_to_one_percent(data):
    for misses, kept in ((60, True), (61, False)):
        assert timeliness(data, 'real_time', {'deadline_misses': misses}, ()).kept is kept
    data.torque[:60] = np.nan
    assert timeliness(data, 'real_time', {}, ()).kept is True
    data.torque[60] = np.nan
    found = timeliness(data, 'real_time', {}, ())
    assert (found.kept, found.unanswered, found.reactions) == (False, 61, 0)


@pytest.mark.parametrize('mode', ['in_process', 'lockstep'])
def test_without_deadlines_nothing_is_excused(setup, data, mode):
    lose(data, 5.4, 0.2)
    found = timeliness(data, mode, {'deadline_misses': 5000}, HELD_AT_5)
    assert found.kept is None and found.judged.all()
    assert judge(data, setup, mode=mode, events=HELD_AT_5).name == NOT_STABLE


def test_one_hold_for_samples_that_were_late_is_not_real_time(data):
    found = timeliness(data, 'real_time', {}, HELD_AT_5)
    assert (found.kept, found.reactions) == (False, 1)
    left_out = data.time[~found.judged]
    assert (left_out[0], left_out[-1]) == pytest.approx((5.0, 6.298))


def test_what_goes_wrong_in_a_gap_and_soon_after_is_the_machine_s_fault(setup, data):
    for start, name in ((5.4, STABLE), (7.0, NOT_STABLE)):
        run = perfect_run(setup)
        lose(run, start, 0.2)
        verdict = judge(run, setup, mode='real_time', events=HELD_AT_5)
        assert verdict.name == name
    data.torque[2500:2700] = np.nan  # 3 % of the samples, in one gap
    lose(data, 5.0, 0.8)
    verdict = judge(data, setup, mode='real_time')
    assert verdict.name == STABLE and verdict.timeliness.kept is False
    assert verdict.judged_share == pytest.approx(1.0 - 1.4 / 9.5, abs=1e-3)


def test_machine_that_keeps_up_excuses_nothing(setup, data):
    """Single samples that are missing are bridged; what happens then is the arm's doing."""
    data.torque[1000:6000:100] = np.nan
    lose(data, 5.0, 0.2)
    verdict = judge(data, setup, mode='real_time', timing={'deadline_misses': 50})
    assert verdict.timeliness.kept is True and verdict.name == NOT_STABLE


def test_samples_without_an_answer_alone_are_not_unstable(setup, data):
    """A third of them; but what is not finite is."""
    data.torque[::3] = data.alpha_des[1::3] = np.nan
    verdict = judge(data, setup, mode='real_time')
    assert (verdict.name, verdict.timeliness.kept) == (STABLE, False)
    data.q[100, 0] = np.inf
    assert judge(data, setup, mode='real_time').reasons == ('a number is not finite',)


def test_run_that_missed_a_tenth_of_its_deadlines_is_not_judged_but_what_is_seen_is_told(
        setup, data):
    for misses, name in ((600, NOT_STABLE), (601, UNJUDGED)):
        run = perfect_run(setup)
        lose(run, 5.0, 0.2)
        verdict = judge(run, setup, mode='real_time', timing={'deadline_misses': misses})
        assert verdict.name == name
        assert any('contact lost' in reason for reason in verdict.reasons)
    data.q[100, 0] = np.inf
    verdict = judge(data, setup, mode='real_time', timing={'deadline_misses': 6000})
    assert verdict.name == NOT_STABLE
    assert judge(data, setup, mode='lockstep', timing={'deadline_misses': 6000}).name != UNJUDGED


def test_holds_for_late_samples_are_no_interventions(setup, data):
    """Ten of them; held as often for another reason, the arm answers for it."""
    def every_half_second(what):
        texts = [(0.0, CALM)]
        for k in range(10):
            texts += [(3.0 + 0.5 * k, what), (3.1 + 0.5 * k, CALM)]
        return events_of(*texts)

    assert judge(data, setup, mode='real_time', events=every_half_second(LATE)).name == STABLE
    held = judge(data, setup, mode='real_time', events=every_half_second(SIDEWAYS))
    assert held.name == 'held by the supervisor' and held.timeliness.kept is True


def test_late_reaction_ends_where_something_else_calls_for_one():
    assert late_reactions(events_of(
        (1.0, LATE), (1.2, RECOVERING), (1.3, SIDEWAYS), (1.5, RECOVERING), (2.0, CALM)),
        9.0) == [(1.0, 1.3)]
    assert late_reactions(events_of((1.0, 'inflate | variance_stale | holding')), 9.0) == []
    assert late_reactions(events_of((1.0, LATE)), 9.0) == [(1.0, 9.0)]
    full = events_of(*((0.001 * k, (CALM, LATE)[k % 2]) for k in range(CAPACITY)))
    assert late_reactions(full, 9.0)[-1] == pytest.approx((0.999, 0.999))
