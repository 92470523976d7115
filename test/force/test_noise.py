"""The lead filter and the windowed variance against theory (P04 eqs 42-44)."""

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.errors import ShapeError
from multicontact_control.force.noise import lead_filter, make_noise_estimator, WindowedVariance
import numpy as np
import pytest
from scipy.signal import dimpulse, freqz

RATE = 500.0


def _config(**values):
    return NoiseEstimatorConfig(contact_names=('a', 'b'), **values)


def test_lead_filter_has_unit_gain_at_dc_and_nineteen_at_high_frequency():
    """DC gain 1.0, so the filter is a lead (paper notes 6)."""
    f = lead_filter(3.0, 60.0, RATE)
    w, response = freqz([f.gain, -f.gain * f.zero], [1.0, -f.pole], worN=[0.0, np.pi])
    assert abs(response[0]) == pytest.approx(1.0, rel=1e-12)
    assert abs(response[1]) == pytest.approx(19.1, rel=0.01)


def test_lead_filter_corners_are_at_three_and_sixty_hertz():
    """Zero and pole are exp(-2 pi f h)."""
    f = lead_filter(3.0, 60.0, RATE)
    assert -np.log(f.zero) * RATE / (2 * np.pi) == pytest.approx(3.0)
    assert -np.log(f.pole) * RATE / (2 * np.pi) == pytest.approx(60.0)


def test_lead_filter_variance_factor_is_the_sum_of_the_squared_impulse_response():
    """White noise leaves the filter with 269 times its variance (paper notes 6)."""
    f = lead_filter(3.0, 60.0, RATE)
    _, (response,) = dimpulse(([f.gain, -f.gain * f.zero], [1.0, -f.pole], 1.0), n=400)
    assert f.variance_factor() == pytest.approx(float((response ** 2).sum()), rel=1e-12)
    assert f.variance_factor() == pytest.approx(269.0, rel=0.005)


def test_windowed_variance_is_numpys_over_the_last_samples():
    """Equations 43-44 with 1/N."""
    samples = np.random.default_rng(4).standard_normal((137, 2)) + [1e3, -5.0]
    window = WindowedVariance(50, 2)
    for k, sample in enumerate(samples):
        variance = window.update(sample)
        np.testing.assert_allclose(
            variance, samples[max(0, k - 49):k + 1].var(axis=0), rtol=1e-9, atol=1e-12)
    assert window.full


def test_lead_window_finds_the_paper_s_variance_in_white_noise():
    """Raw noise of 0.047 N gives R = 0.6 N^2 (paper notes 6)."""
    estimator = make_noise_estimator(_config())
    rng = np.random.default_rng(5)
    values = [estimator.update(10.0 + 0.0472 * rng.standard_normal(2)) for _ in range(20000)]
    np.testing.assert_allclose(np.mean(values[100:], axis=0), 0.6, rtol=0.05)


def test_lead_window_ignores_a_constant_force_and_starts_in_steady_state():
    """No transient from the first sample: R falls to its floor when the window is full."""
    estimator = make_noise_estimator(_config())
    values = [estimator.update(np.array([15.0, 3.0])) for _ in range(60)]
    np.testing.assert_array_equal(values[48], [0.6, 0.6])
    np.testing.assert_array_equal(values[49], [1e-3, 1e-3])


def test_lead_window_lifted_by_a_force_step_as_the_literal_filter_says():
    """A 10 N step alone lifts R to tens of N^2 and passes with the window (paper notes 6)."""
    estimator = make_noise_estimator(_config())
    force = np.repeat([[2.0, 2.0], [12.0, 12.0]], [100, 200], axis=0)
    rise = np.exp(-np.arange(200) / 10.0)[:, None]  # the loop's 20 ms
    force[100:] -= 10.0 * rise * (1.0 + np.arange(200)[:, None] / 10.0)
    values = np.array([estimator.update(f) for f in force])
    assert 15.0 < values[:, 0].max() < 80.0
    assert values[-1, 0] < 0.1


@pytest.mark.parametrize('name', ['lead_window', 'fixed'])
def test_estimators_drop_and_count_samples_that_are_not_finite(name):
    """Neither NaN nor infinity ever reaches R."""
    estimator = make_noise_estimator(_config(estimator=name))
    rng = np.random.default_rng(6)
    for k in range(200):
        sample = rng.standard_normal(2)
        if k % 10 == 3:
            sample[k % 2] = np.nan if k % 20 == 3 else np.inf
        assert np.isfinite(estimator.update(sample)).all()
    assert estimator.dropped == 20


def test_lead_window_keeps_within_floor_and_ceiling():
    """Any finite samples give a variance the observer can bear."""
    estimator = make_noise_estimator(_config(variance_floor=0.1, variance_ceiling=50.0))
    for scale in (0.0, 1e6):
        rng = np.random.default_rng(7)
        values = np.array([estimator.update(scale * rng.standard_normal(2)) for _ in range(120)])
        assert values.min() >= 0.1
        assert values.max() <= 50.0


def test_estimators_refuse_a_sample_of_another_size():
    """The message names the array."""
    for name in ('lead_window', 'fixed'):
        with pytest.raises(ShapeError, match=r'alpha: expected shape \(2,\)'):
            make_noise_estimator(_config(estimator=name)).update(np.zeros(3))


def test_lead_window_reset_forgets_all_samples():
    """Two runs from reset are one run."""
    estimator = make_noise_estimator(_config())
    samples = np.random.default_rng(8).standard_normal((80, 2))
    first = [estimator.update(sample) for sample in samples]
    estimator.reset()
    np.testing.assert_array_equal([estimator.update(sample) for sample in samples], first)
