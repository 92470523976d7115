"""Estimators that work on innovations: their formulas, and what they find in a force loop."""

from dataclasses import astuple

from force_loop import estimator_of, observer_of, run_force_loop
from multicontact_control.force.noise import Innovation
import numpy as np
import pytest

NAMES = ['innovation', 'sage_husa', 'variational_bayes']
FORCE = np.array([10.0])


def _innovations(count, rng, contacts=1):
    shape = (count, contacts)
    return [Innovation(*values) for values in zip(
        rng.standard_normal(shape), rng.uniform(0.1, 1.0, shape), rng.uniform(0.5, 2.0, shape))]


def test_innovation_gives_the_observers_residual_and_posterior_variance():
    """Test e = y - C x and C P C^T, from r, C P_1 C^T and R alone; 0 where there is none."""
    observer, rng = observer_of(), np.random.default_rng(17)
    for _ in range(20):
        force, variance = rng.standard_normal(), 10.0 ** rng.uniform(-3, 3)
        observer.update(force, variance)
        observer.command(1.0)
    innovation = Innovation(*(np.append(each, 0.0) for each in astuple(observer.innovation)))
    np.testing.assert_array_equal(innovation.valid, [True, False])
    np.testing.assert_allclose(
        innovation.residual, [force - observer.x_est[0], 0.0], rtol=1e-9)
    np.testing.assert_allclose(
        innovation.posterior_variance, [observer.P[0, 0], 0.0], rtol=1e-9)


def test_innovation_is_the_mean_over_the_window_within_its_floor():
    """(1/N) sum [r r^T - C P_1 C^T], once there are N."""
    estimator = estimator_of('innovation')
    innovations = _innovations(80, np.random.default_rng(18))
    values = [estimator.update(FORCE, innovation)[0] for innovation in innovations]
    assert values[:49] == [0.6] * 49
    series = np.array([(i.innovation ** 2 - i.prior_variance)[0] for i in innovations])
    expected = [max(series[k - 49:k + 1].mean(), 1e-3) for k in range(49, 80)]
    np.testing.assert_allclose(values[49:], expected, rtol=1e-10)
    small = Innovation(np.array([0.1]), np.array([6.4]), np.array([0.6]))
    assert [estimator.update(FORCE, small)[0] for _ in range(50)][-1] == 1e-3


def test_sage_husa_is_its_recursion():
    """R_k = (1 - d_k) R_k-1 + d_k (e e^T + C P C^T), d_k = (1 - b) / (1 - b^k)."""
    estimator = estimator_of('sage_husa', window=10)
    R = 123.0  # forgotten with d_1 = 1
    for k, innovation in enumerate(_innovations(60, np.random.default_rng(19)), start=1):
        d = (1.0 - 0.9) / (1.0 - 0.9 ** k)
        r, p, R_used = (float(v[0]) for v in (
            innovation.innovation, innovation.prior_variance, innovation.variance_used))
        e, CPC = r * R_used / (p + R_used), p * R_used / (p + R_used)
        R = (1.0 - d) * R + d * (e * e + CPC)
        assert estimator.update(FORCE, innovation)[0] == pytest.approx(R, rel=1e-12)


def test_variational_bayes_is_its_fixed_point_iteration():
    """Check alpha + 1/2 and beta + e^2/2 + C P C^T/2, written out for one contact."""
    estimator = estimator_of('variational_bayes', window=20)
    alpha = 0.5 / 0.05
    beta = alpha * 0.6
    for innovation in _innovations(60, np.random.default_rng(20)):
        r, p = float(innovation.innovation[0]), float(innovation.prior_variance[0])
        alpha, beta_prior = 0.95 * alpha + 0.5, 0.95 * beta
        for _ in range(3):
            R = beta / alpha
            gain = p / (p + R)
            beta = beta_prior + 0.5 * ((1.0 - gain) * r) ** 2 + 0.5 * (1.0 - gain) * p
        assert estimator.update(FORCE, innovation)[0] == pytest.approx(beta / alpha, rel=1e-12)


@pytest.mark.parametrize('name', NAMES)
def test_estimators_find_the_variance_of_white_noise_and_follow_its_rise(name):
    """In their own loop: from 0.6 at rest to 100 in motion, as in the paper's Fig. 6."""
    sigma = np.where(np.arange(6000) < 3000, np.sqrt(0.6), 10.0)
    found = run_force_loop(
        estimator_of(name), sigma * np.random.default_rng(21).standard_normal(6000))
    assert found[500:3000].mean() == pytest.approx(0.6, rel=0.15)
    assert 50.0 < np.median(found[3250:3500]) < 200.0  # a few windows later
    assert found[3500:].mean() == pytest.approx(100.0, rel=0.15)


@pytest.mark.parametrize('name', NAMES)
def test_estimators_leave_out_an_inactive_contact(name):
    rng = np.random.default_rng(24)
    both, alone = estimator_of(name, contacts=2), estimator_of(name)
    for innovation in _innovations(200, rng, contacts=2):
        there = rng.random() < 0.5
        values = np.array(astuple(innovation))
        before = both.update(np.zeros(2))
        R = both.update(np.zeros(2), Innovation(*(values * [1.0, there])))
        if there:
            assert R[1] == pytest.approx(
                alone.update(np.zeros(1), Innovation(*values[:, 1:]))[0], rel=1e-12)
        else:
            assert R[1] == before[1]


def test_innovation_is_too_sensitive_to_a_force_on_another_contact():
    """A noise-free step of 5 N lifts R five times higher than with the filter (P04 sec. 4.2)."""
    step = 5.0 * (np.arange(600) >= 300)
    peaks = {name: run_force_loop(estimator_of(name), leak=step)[300:].max()
             for name in ('innovation', 'hf_window')}
    assert peaks['innovation'] > 5.0 * peaks['hf_window']
