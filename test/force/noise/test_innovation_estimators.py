"""The estimators that work on innovations: their formulas, and what they find in a force loop."""

from force_loop import estimator_of, run_force_loop
from multicontact_control.force.noise import Innovation
import numpy as np
import pytest

NAMES = ['innovation', 'sage_husa', 'variational_bayes']
FORCE = np.array([10.0])


def _innovations(count, rng, contacts=1):
    shape = (count, contacts)
    return [Innovation(*values) for values in zip(
        rng.standard_normal(shape), rng.uniform(0.1, 1.0, shape), rng.uniform(0.5, 2.0, shape))]


@pytest.mark.parametrize(('form', 'terms'), [
    ('prior', lambda i: i.innovation ** 2 - i.prior_variance),
    ('posterior', lambda i: i.residual ** 2 + i.posterior_variance)])
def test_innovation_is_the_mean_of_its_form_over_the_window(form, terms):
    """(1/N) sum [r r^T - C P_1 C^T] or [e e^T + C P C^T], once there are N."""
    estimator = estimator_of('innovation', innovation_form=form)
    innovations = _innovations(80, np.random.default_rng(18))
    values = [estimator.update(FORCE, innovation)[0] for innovation in innovations]
    assert values[:49] == [0.6] * 49
    series = np.array([terms(innovation)[0] for innovation in innovations])
    expected = [max(series[k - 49:k + 1].mean(), 1e-3) for k in range(49, 80)]
    np.testing.assert_allclose(values[49:], expected, rtol=1e-10)


def test_innovation_in_prior_form_stops_at_the_floor():
    """Innovations smaller than predicted would give a negative variance."""
    estimator = estimator_of('innovation')
    small = Innovation(np.array([0.1]), np.array([6.4]), np.array([0.6]))
    assert [estimator.update(FORCE, small)[0] for _ in range(50)][-1] == 1e-3


def test_sage_husa_is_its_recursion():
    """R_k = (1 - d_k) R_k-1 + d_k (e e^T + C P C^T), d_k = (1 - b) / (1 - b^k)."""
    estimator = estimator_of('sage_husa', forgetting_factor=0.9)
    R = 123.0  # forgotten with d_1 = 1
    for k, innovation in enumerate(_innovations(60, np.random.default_rng(19)), start=1):
        d = (1.0 - 0.9) / (1.0 - 0.9 ** k)
        r, p, R_used = (float(v[0]) for v in (
            innovation.innovation, innovation.prior_variance, innovation.variance_used))
        e, CPC = r * R_used / (p + R_used), p * R_used / (p + R_used)
        R = (1.0 - d) * R + d * (e * e + CPC)
        assert estimator.update(FORCE, innovation)[0] == pytest.approx(R, rel=1e-12)


@pytest.mark.parametrize('iterations', [1, 3])
def test_variational_bayes_is_its_fixed_point_iteration(iterations):
    """Check alpha + 1/2 and beta + e^2/2 + C P C^T/2, written out for one contact."""
    estimator = estimator_of('variational_bayes', bayes_decay=0.95, bayes_iterations=iterations)
    alpha = 0.5 / 0.05
    beta = alpha * 0.6
    for innovation in _innovations(60, np.random.default_rng(20)):
        r, p = float(innovation.innovation[0]), float(innovation.prior_variance[0])
        alpha, beta_prior = 0.95 * alpha + 0.5, 0.95 * beta
        for _ in range(iterations):
            R = beta / alpha
            gain = p / (p + R)
            beta = beta_prior + 0.5 * ((1.0 - gain) * r) ** 2 + 0.5 * (1.0 - gain) * p
        assert estimator.update(FORCE, innovation)[0] == pytest.approx(beta / alpha, rel=1e-12)


@pytest.mark.parametrize('variance', [0.1, 0.6, 100.0])
@pytest.mark.parametrize('name', NAMES)
def test_estimators_find_the_variance_of_white_noise_in_their_own_loop(name, variance):
    """R fed back to the observer settles at the noise that there is."""
    noise = np.sqrt(variance) * np.random.default_rng(21).standard_normal(6000)
    run = run_force_loop(estimator_of(name), 6000, noise=noise)
    assert run.noise_variance[1000:].mean() == pytest.approx(variance, rel=0.15)


@pytest.mark.parametrize('name', NAMES)
def test_estimators_follow_a_rise_of_the_noise_within_a_few_windows(name):
    """From 0.6 at rest to 100 in motion, as in the paper's Fig. 6."""
    sigma = np.where(np.arange(3000) < 1500, np.sqrt(0.6), 10.0)
    noise = sigma * np.random.default_rng(22).standard_normal(3000)
    run = run_force_loop(estimator_of(name), 3000, noise=noise)
    assert np.median(run.noise_variance[1000:1500]) < 1.0
    assert 50.0 < np.median(run.noise_variance[1750:2000]) < 200.0


@pytest.mark.parametrize('name', NAMES)
def test_estimators_give_the_last_variance_without_an_innovation(name):
    """A tick without innovation changes nothing, now or later."""
    with_gap, without = estimator_of(name), estimator_of(name)
    for k, innovation in enumerate(_innovations(120, np.random.default_rng(23))):
        if k == 80:
            last = with_gap.update(FORCE, innovation)
            np.testing.assert_array_equal(with_gap.update(FORCE), last)
            np.testing.assert_array_equal(without.update(FORCE, innovation), last)
        else:
            np.testing.assert_array_equal(
                with_gap.update(FORCE, innovation), without.update(FORCE, innovation))
    assert with_gap.dropped == 0


@pytest.mark.parametrize('name', NAMES)
def test_estimators_keep_an_inactive_contact_out_of_it(name):
    """A contact's R depends on its own innovations, however often it was out of contact."""
    rng = np.random.default_rng(24)
    both, alone = estimator_of(name, contacts=2), estimator_of(name)
    absent = rng.random(200) < 0.5
    for gone, innovation in zip(absent, _innovations(200, rng, contacts=2)):
        there = np.array([1.0, 0.0 if gone else 1.0])
        masked = Innovation(*(values * there for values in (
            innovation.innovation, innovation.prior_variance, innovation.variance_used)))
        before = both.update(np.zeros(2))
        R = both.update(np.zeros(2), masked)
        if gone:
            assert R[1] == before[1]
        else:
            own = Innovation(*(values[1:] for values in (
                innovation.innovation, innovation.prior_variance, innovation.variance_used)))
            assert R[1] == pytest.approx(alone.update(np.zeros(1), own)[0], rel=1e-12)


class _Listening:
    """An estimator that hears the loop while the observer works with a fixed R."""

    def __init__(self, name, variance):
        self._estimator, self._variance, self.values = estimator_of(name), variance, []

    def update(self, alpha, innovation):
        self.values.append(self._estimator.update(alpha, innovation)[0])
        return np.array([self._variance])


STEP = np.where(np.arange(600) < 300, 0.0, 1.0)


def test_innovation_is_too_sensitive_to_a_force_on_another_contact():
    """A noise-free step of 5 N lifts R five times higher than with the filter (P04 sec. 4.2)."""
    peaks = {name: run_force_loop(estimator_of(name), 600, leak=5.0 * STEP)
             .noise_variance[300:].max() for name in ('innovation', 'hf_window')}
    assert peaks['innovation'] > 5.0 * peaks['hf_window']


def test_innovation_is_too_sensitive_to_a_disturbance_of_the_motion():
    """The same for a step of 1 m/s^2 at the input, on one observer with R = 0.6."""
    peaks = {}
    for name in ('innovation', 'hf_window'):
        estimator = _Listening(name, 0.6)
        run_force_loop(estimator, 600, disturbance=STEP)
        peaks[name] = max(estimator.values[300:])
    assert peaks['innovation'] > 5.0 * peaks['hf_window']
