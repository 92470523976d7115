"""The windowed variances against theory and the paper's numbers (P04 eqs 42-44)."""

from force_loop import estimator_of
from multicontact_control.force.noise import lead_filter
import numpy as np
import pytest


def test_lead_window_finds_the_paper_s_variance_in_white_noise():
    """Raw noise of 0.047 N gives R = 0.6 N^2 (paper notes 6)."""
    estimator = estimator_of('lead_window', contacts=2)
    rng = np.random.default_rng(5)
    values = [estimator.update(10.0 + 0.0472 * rng.standard_normal(2)) for _ in range(20000)]
    np.testing.assert_allclose(np.mean(values[100:], axis=0), 0.6, rtol=0.05)


def test_lead_window_ignores_a_constant_force_and_starts_in_steady_state():
    """No transient from the first sample: R falls to its floor when the window is full."""
    estimator = estimator_of('lead_window', contacts=2)
    values = [estimator.update(np.array([15.0, 3.0])) for _ in range(60)]
    np.testing.assert_array_equal(values[48], [0.6, 0.6])
    np.testing.assert_array_equal(values[49], [1e-3, 1e-3])


def test_lead_window_lifted_by_a_force_step_as_the_literal_filter_says():
    """A 10 N step alone lifts R to tens of N^2 and passes with the window (paper notes 6)."""
    estimator = estimator_of('lead_window', contacts=2)
    force = np.repeat([[2.0, 2.0], [12.0, 12.0]], [100, 200], axis=0)
    rise = np.exp(-np.arange(200) / 10.0)[:, None]  # the loop's 20 ms
    force[100:] -= 10.0 * rise * (1.0 + np.arange(200)[:, None] / 10.0)
    values = np.array([estimator.update(f) for f in force])
    assert 15.0 < values[:, 0].max() < 80.0
    assert values[-1, 0] < 0.1


def test_hf_window_gives_the_paper_s_variance_a_366th():
    """The two readings of the filter differ by the square of 19 (paper notes 6)."""
    lead, hf = (estimator_of(name, variance_floor=1e-9) for name in ('lead_window', 'hf_window'))
    rng = np.random.default_rng(14)
    for _ in range(100):
        sample = rng.standard_normal(1)
        values = lead.update(sample), hf.update(sample)
    assert values[0] / values[1] == pytest.approx(366.0, rel=0.01)


def test_window_is_the_variance_of_the_force_itself():
    """Equation 43 on alpha: a slope counts as noise."""
    estimator = estimator_of('window')
    force = np.linspace(0.0, 30.0, 80) + np.random.default_rng(15).standard_normal(80)
    values = [estimator.update(np.array([value]))[0] for value in force]
    assert values[48] == 0.6
    np.testing.assert_allclose(
        values[49:], [force[k - 49:k + 1].var() for k in range(49, 80)], rtol=1e-12)


def test_window_scaled_by_the_filter_s_factor_agrees_with_lead_window_at_rest():
    """`variance_scale` brings both to the same R in white noise."""
    factor = lead_filter(3.0, 60.0, 500.0).variance_factor()
    rng = np.random.default_rng(16)
    lead, window = estimator_of('lead_window'), estimator_of('window', variance_scale=factor)
    samples = 10.0 + 0.0472 * rng.standard_normal((20000, 1))
    means = [np.mean([estimator.update(sample) for sample in samples][100:])
             for estimator in (lead, window)]
    assert means[1] == pytest.approx(means[0], rel=0.03)
