from dataclasses import replace

from multicontact_control.experiment.claim_metrics import (
    designed_rise,
    disturbance_summary,
    evidence_of,
    growing_line,
    quiet_windows,
    recoveries,
)
from multicontact_control.experiment.claims import judge_claims
from multicontact_control.experiment.judge import judge
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.summary import summarise
import numpy as np
import pytest
from synthetic_run import disturbance_setup, perfect_run

PUSH, LASTING, MOVING = 5.0, 6.5, 13.0  # s, the pushes of the scenario


@pytest.fixture
def setup():
    return disturbance_setup()


def with_error(data, start, end, error, contact=0):
    true = data.alpha_true.copy()
    true[(data.time >= start - 1e-9) & (data.time < end - 1e-9), contact] += error
    return replace(data, alpha_true=true)


def test_recovery_counts_from_the_end_of_a_short_push(setup):
    data = with_error(perfect_run(setup), PUSH, PUSH + 0.35, 2.0)
    answer = recoveries(data, setup, 0)[0]
    assert answer['recovery'] == pytest.approx(0.25, abs=0.003)
    assert answer['peak'] == pytest.approx(2.0)
    assert answer['band'] == pytest.approx(0.05 * 15.0)


def test_recovery_counts_from_the_start_of_a_lasting_push(setup):
    data = with_error(perfect_run(setup), LASTING, LASTING + 0.4, 2.0)
    assert recoveries(data, setup, 0)[1]['recovery'] == pytest.approx(0.4, abs=0.003)


def test_recovery_of_a_push_that_stays_in_the_band_is_zero(setup):
    data = with_error(perfect_run(setup), PUSH, PUSH + 0.5, 0.7)
    assert recoveries(data, setup, 0)[0]['recovery'] == 0.0


def test_recovery_needs_the_error_to_stay_in_the_band(setup):
    data = with_error(perfect_run(setup), PUSH, PUSH + 0.2, 2.0)
    data = with_error(data, PUSH + 0.25, PUSH + 0.3, -2.0)
    assert recoveries(data, setup, 0)[0]['recovery'] == pytest.approx(0.2, abs=0.003)


def test_recovery_is_none_if_it_does_not_come_before_the_next_event(setup):
    data = with_error(perfect_run(setup), PUSH, LASTING, 2.0)
    assert recoveries(data, setup, 0)[0]['recovery'] is None


def test_recovery_band_widens_with_the_runs_own_noise(setup):
    data = perfect_run(setup)
    data = with_error(data, MOVING - 1.0, MOVING, np.resize([1.0, -1.0], 500))
    assert recoveries(data, setup, 0)[2]['band'] == pytest.approx(3.0)
    assert recoveries(data, setup, 0)[2]['moving']


def test_recovery_is_none_once_the_run_is_unstable(setup):
    data = with_error(perfect_run(setup), 4.0, 4.1, 80.0)
    assert all(answer['recovery'] is None
               for answer in recoveries(data, setup, 0, judge(data, setup).unstable_at))


def test_instability_time_of_a_stable_run_is_none(setup):
    assert judge(perfect_run(setup), setup).unstable_at is None


def test_instability_time_of_a_lost_contact_is_after_a_tenth_of_a_second(setup):
    data = with_error(perfect_run(setup), 10.0, 10.3, -10.0, contact=1)
    assert judge(data, setup).unstable_at == pytest.approx(10.1, abs=0.003)
    short = with_error(perfect_run(setup), 10.0, 10.09, -10.0, contact=1)
    assert judge(short, setup).unstable_at is None


def test_instability_time_of_an_excessive_force_is_at_once(setup):
    data = with_error(perfect_run(setup), 11.0, 11.01, 61.0)
    assert judge(data, setup).unstable_at == pytest.approx(11.0)


def test_oscillation_finds_the_frequency(setup):
    data = perfect_run(setup)
    time = data.time[(data.time >= 10.0) & (data.time < 11.0)]
    data = with_error(data, 10.0, 11.0, np.sin(2.0 * np.pi * 42.0 * time))
    assert growing_line(data, 11.0) == pytest.approx(42.0, abs=0.5)


def test_quiet_windows_leave_the_pushes_out(setup):
    data = perfect_run(setup)
    rest, moving = quiet_windows(data, setup)
    for start, mask in ((PUSH, rest), (LASTING, rest), (MOVING, moving)):
        assert not mask[(data.time >= start) & (data.time < start + 1.0)].any()
    assert rest.any() and moving.any()


def test_disturbance_summary_gives_times_after_the_start_of_motion(setup):
    data = with_error(perfect_run(setup), 11.0, 11.01, 61.0)
    assert disturbance_summary(data, setup, 11.0)['unstable_after_motion_s'] == pytest.approx(2.0)


def test_couples_are_no_forces_that_claims_are_about():
    """They may be 0, or of either sign, and no contact is lost for that."""
    setup = resolve('edge', plant='rigid')
    data = perfect_run(setup)
    data.alpha_true[:] = data.alpha_des[:] = setup.commanded(data.time)
    disturbances = disturbance_summary(data, setup, None)['contacts']
    assert [disturbances[name]['moving']['lost'] for name in data.contact_names] == [0.0, None]
    evidence = evidence_of(data, setup, summarise(data, setup, mode='in_process', timing={}))
    assert [*evidence['contacts']] == ['edge']
    moving = next(claim for claim in judge_claims(evidence) if 'contact lost' in claim.why)
    assert moving.holds is True


def test_designed_rise_of_two_equal_poles_is_2_146_time_constants(setup):
    force = setup.controller.force
    assert designed_rise(force) == pytest.approx(0.006 + 2.1462 * 0.02, abs=1e-5)
    fast = force.model_copy(update={'second_pole_ratio': 1e4})
    assert designed_rise(fast) == pytest.approx(0.026, abs=1e-4)
