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
    summary = summarise_run(
        RunMetrics(data, setup), mode='in_process', timing={}, **changes
    )
    return collect_evidence(RunMetrics(data, setup), summary)


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


@pytest.fixture(scope='module')
def setup():
    return resolve('disturbance', plant='rigid')


@pytest.fixture(scope='module')
def fixed():
    return resolve('disturbance', plant='rigid', **FIXED)


@pytest.fixture(scope='module')
def data(setup):
    return paper_run(setup)


def unstable(data):
    """Return the run with the board lost for good 1.7 s after the motion began."""
    return changed(data, 'alpha_true', (data.time >= MOTION + 1.6, 1), 0.0)


def late_rise(data):
    return replace(data, alpha_true=delayed(data, 0.1))


def noisy_motion(data):
    noise = 4.0 * np.random.default_rng(1).standard_normal(data.alpha_true.shape)
    return replace(
        data, alpha_true=data.alpha_true + (data.time >= MOTION)[:, None] * noise
    )


BREAKERS = [
    ('designed time constant', late_rise),
    (
        'motion is tracked',
        lambda x: changed(  # less than 5 mm rms over all 14 s under load
            x, 'position', (x.time >= MOTION + 2.0, 0), 6e-3
        ),
    ),
    (
        'orientation stays',
        lambda x: replace(
            x,
            quaternion=np.tile([np.sin(0.015), 0.0, 0.0, np.cos(0.015)], (x.ticks, 1)),
        ),
    ),
    ('keeps the control working', unstable),
    ('0.6 N² at rest', lambda x: changed(x, 'noise_variance', x.time < MOTION, 1.3)),
    (
        'about 100 N²',
        lambda x: changed(x, 'noise_variance', (x.time >= MOTION, 1), 20.0),
    ),
    ('not too affected', noisy_motion),
    ('not too affected', unstable),
    (
        'not too affected',
        lambda x: changed(  # contact lost for a sample
            x, 'alpha_true', (np.flatnonzero(x.time > 12.0)[:1], 0), 0.0
        ),
    ),
    (
        'disturbs both',
        lambda x: changed(
            x, 'alpha_true', ((x.time >= MOTION) & (x.time < MOTION + 2.0), 1), 10.01
        ),
    ),
]


@pytest.mark.parametrize('words, breaker', BREAKERS)
def test_claim_of_one_run_follows_its_data(data, setup, words, breaker):
    assert claim_of(data, setup, words).holds is True
    assert claim_of(breaker(data), setup, words).holds is False


def test_claims_that_the_run_does_not_tell_of_are_not_judged(data, setup, fixed):
    single = {words for words, _ in BREAKERS}
    for claim in claims.STATEMENTS:
        assert (claim_of(data, setup, claim.text).holds is None) == (
            not any(words in claim.text for words in single)
        )
    for words in (
        '0.6 N² at rest',
        'keeps the control working',
    ):  # not with another estimator
        assert claim_of(data, fixed, words).holds is None
    assert claim_of(data, fixed, 'Without on-line R').holds is False
    assert (
        claim_of(data, setup, 'not too affected', ended_early=INTERRUPTED).holds is None
    )


def test_fixed_claim_follows_the_runs_with_a_fixed_variance(data, setup, fixed):
    bad, good = row('fixed', unstable(data), fixed), row('fixed', data, fixed)
    at_rest = row(
        'fixed', changed(data, 'alpha_true', (data.time >= 4.0, 1), 0.0), fixed
    )
    for rows, holds in (([bad, bad], True), ([bad, good], False), ([at_rest], False)):
        assert claim_of(data, setup, 'Without on-line R', rows).holds is holds
    other = row('fixed', unstable(data), resolve('disturbance', plant='puma', **FIXED))
    assert claim_of(data, setup, 'Without on-line R', [other]).holds is None


def pushed(setup, duration):
    """Return a run whose forces are 2 N off for a while after each push at rest."""
    data = perfect_run(setup)
    for start, length in ((5.0, 0.1 + duration), (6.5, duration)):
        data = changed(
            data,
            'alpha_true',
            ((data.time >= start) & (data.time < start + length), 0),
            17.0,
        )
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
    for peak, holds in ((60.0, True), (1.2, False)):
        jumping = changed(
            data, 'noise_variance', (data.time > 5.0) & (data.time < 5.3), peak
        )
        rows = [row('lead_window', data, setup), row('innovation', jumping, setup)]
        assert claim_of(data, setup, 'Maybeck', rows).holds is holds


def test_stiffness_claims_need_a_wrong_stiffness():
    stiff = resolve(
        'disturbance',
        plant='rigid',
        plant_overrides={
            'surfaces': {name: {'stiffness': 12000.0} for name in ('table', 'board')}
        },
    )
    data = paper_run(stiff)
    offset = replace(data, alpha_true=data.alpha_true + 0.5)
    for run, *holds in (
        (data, True, True),
        (late_rise(data), True, False),
        (offset, False, True),
    ):
        assert [
            claim_of(run, stiff, words).holds
            for words in ('stiffness that is not known', 'leaves the force dynamics')
        ] == holds


def test_designed_rise_of_two_equal_poles_is_2_146_time_constants(setup):
    force = setup.controller.force
    assert designed_rise(force) == pytest.approx(0.006 + 2.1462 * 0.02, abs=1e-5)
    fast = force.model_copy(update={'second_pole_ratio': 1e4})
    assert designed_rise(fast) == pytest.approx(0.026, abs=1e-4)
