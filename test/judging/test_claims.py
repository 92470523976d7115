"""Every claim holds on data made to the paper, and does not on data that break it."""

from dataclasses import replace

from multicontact_control.judging import claims
from multicontact_control.judging.contact_metrics import designed_rise
from multicontact_control.judging.evidence import collect_evidence
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_modes import INTERRUPTED
from multicontact_control.judging.run_summary import summarise_run
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from synthetic_run import delayed, paper_run, perfect_run

MOTION = 9.0  # s, its start in the scenario
FIXED = {'noise_estimator': {'estimator': 'fixed'}}


def evidence(data, setup, **changes):
    metrics = RunMetrics(data, setup)
    summary = summarise_run(metrics, mode='in_process', timing={}, **changes)
    return collect_evidence(metrics, summary)


def claim_of(data, setup, words, rows=(), **changes):
    judged = claims.judge_claims(evidence(data, setup, **changes), rows)
    (claim,) = [claim for claim in judged if words in claim.claim]
    return claim


def row(label, data, setup):
    return {**evidence(data, setup), 'estimator': label}


def changed(data, name, window, values):
    series = getattr(data, name).copy()
    series[window] = values
    return replace(data, **{name: series})


def between(data, start, end):
    """Return which samples are in a time [s], its end excluded, shape (ticks,)."""
    return (data.time >= start) & (data.time < end)


@pytest.fixture(scope='module')
def setup():
    return resolve('disturbance', plant='rigid')


@pytest.fixture(scope='module')
def fixed():
    return resolve('disturbance', plant='rigid', **FIXED)


@pytest.fixture(scope='module')
def data(setup):
    return paper_run(setup)


def lose_board(data):
    """Return the run with the board lost for good 1.6 s after the motion began."""
    return changed(data, 'alpha_true', (data.time >= MOTION + 1.6, 1), 0.0)


def lose_table_for_a_sample(data):
    sample = np.flatnonzero(data.time > 12.0)[0]
    return changed(data, 'alpha_true', (sample, 0), 0.0)


def rise_late(data):
    return replace(data, alpha_true=delayed(data, 0.1))


def shake_in_motion(data):
    noise = 4.0 * np.random.default_rng(1).standard_normal(data.alpha_true.shape)
    noise[data.time < MOTION] = 0.0
    return replace(data, alpha_true=data.alpha_true + noise)


def stay_aside(data):
    """Return the run 6 mm off under load: less than 5 mm rms over all 14 s."""
    return changed(data, 'position', (data.time >= MOTION + 2.0, 0), 6e-3)


def turn_tool(data):
    turned = data.quaternion.copy()
    turned[:] = np.sin(0.015), 0.0, 0.0, np.cos(0.015)
    return replace(data, quaternion=turned)


def double_variance_at_rest(data):
    return changed(data, 'noise_variance', data.time < MOTION, 1.3)


def keep_variance_small_in_motion(data):
    return changed(data, 'noise_variance', (data.time >= MOTION, 1), 20.0)


def start_undisturbed(data):
    start = between(data, MOTION, MOTION + 2.0)
    return changed(data, 'alpha_true', (start, 1), 10.01)


BREAKERS = [
    ('designed time constant', rise_late),
    ('motion is tracked', stay_aside),
    ('orientation stays', turn_tool),
    ('keeps the control working', lose_board),
    ('0.6 N² at rest', double_variance_at_rest),
    ('about 100 N²', keep_variance_small_in_motion),
    ('not too affected', shake_in_motion),
    ('not too affected', lose_board),
    ('not too affected', lose_table_for_a_sample),
    ('disturbs both', start_undisturbed),
]
OF_ONE_RUN = {words for words, _ in BREAKERS}


@pytest.mark.parametrize('words, breaker', BREAKERS)
def test_claim_of_one_run_follows_its_data(data, setup, words, breaker):
    assert claim_of(data, setup, words).holds is True
    assert claim_of(breaker(data), setup, words).holds is False


@pytest.mark.parametrize('claim', [claim.text for claim in claims.STATEMENTS])
def test_claims_that_the_run_does_not_tell_of_are_not_judged(data, setup, claim):
    told = any(words in claim for words in OF_ONE_RUN)
    judged = claim_of(data, setup, claim).holds is not None
    assert judged == told


@pytest.mark.parametrize('words', ['0.6 N² at rest', 'keeps the control working'])
def test_claims_of_the_paper_on_r_are_not_judged_with_another_estimator(
    data, fixed, words
):
    assert claim_of(data, fixed, words).holds is None


def test_claim_is_not_judged_by_a_run_that_was_interrupted(data, setup):
    claim = claim_of(data, setup, 'not too affected', ended_early=INTERRUPTED)
    assert claim.holds is None


def test_fixed_claim_is_judged_by_a_run_with_a_fixed_variance(data, fixed):
    assert claim_of(data, fixed, 'Without on-line R').holds is False


def test_fixed_claim_follows_the_runs_with_a_fixed_variance(data, setup, fixed):
    bad = row('fixed', lose_board(data), fixed)
    good = row('fixed', data, fixed)
    lost_at_rest = changed(data, 'alpha_true', (data.time >= 4.0, 1), 0.0)
    at_rest = row('fixed', lost_at_rest, fixed)
    other_plant = resolve('disturbance', plant='puma', **FIXED)
    other = row('fixed', lose_board(data), other_plant)

    def holds(*rows):
        return claim_of(data, setup, 'Without on-line R', rows).holds

    assert holds(bad, bad) is True
    assert holds(bad, good) is False
    assert holds(at_rest) is False
    assert holds(other) is None


def pushed(setup, duration):
    """Return a run whose forces are 2 N off for a while after each push at rest."""
    data = perfect_run(setup)
    for start, end in ((5.0, 5.1 + duration), (6.5, 6.5 + duration)):
        data.alpha_true[between(data, start, end), 0] = 17.0
    return data


@pytest.mark.parametrize(
    'lead, slow, holds',
    [(0.2, 0.5, True), (0.2, 0.3, False), (60.0, 60.0, None), (0.0, 0.3, None)],
)
def test_filter_claim_compares_the_recoveries(data, setup, lead, slow, holds):
    rows = [
        row('lead_window', pushed(setup, lead), setup),
        row('window rescaled', pushed(setup, slow), setup),
    ]
    assert claim_of(data, setup, 'Without the high-pass filter', rows).holds is holds


def test_maybeck_claim_compares_the_reactions_of_the_estimates(data, setup):
    after_push = between(data, 5.0, 5.3)
    for peak, holds in ((60.0, True), (1.2, False)):
        jumping = changed(data, 'noise_variance', after_push, peak)
        rows = [row('lead_window', data, setup), row('innovation', jumping, setup)]
        assert claim_of(data, setup, 'Maybeck', rows).holds is holds


def press_too_much(data):
    return replace(data, alpha_true=data.alpha_true + 0.5)


@pytest.mark.parametrize(
    ('words', 'breaker', 'other'),
    [
        ('stiffness that is not known', press_too_much, rise_late),
        ('leaves the force dynamics', rise_late, press_too_much),
    ],
)
def test_stiffness_claims_follow_runs_with_a_wrong_stiffness(words, breaker, other):
    surface = {'stiffness': 12000.0}
    surfaces = {'table': surface, 'board': surface}
    stiff = resolve(
        'disturbance', plant='rigid', plant_overrides={'surfaces': surfaces}
    )
    data = paper_run(stiff)
    assert claim_of(data, stiff, words).holds is True
    assert claim_of(other(data), stiff, words).holds is True
    assert claim_of(breaker(data), stiff, words).holds is False


def test_designed_rise_of_two_equal_poles_is_2_146_time_constants(setup):
    force = setup.controller.force
    assert designed_rise(force) == pytest.approx(0.006 + 2.1462 * 0.02, abs=1e-5)
    fast = force.model_copy(update={'second_pole_ratio': 1e4})
    assert designed_rise(fast) == pytest.approx(0.026, abs=1e-4)
