"""The lead filter and the windowed variance against scipy and the paper (P04 eqs 42-44)."""

from force_loop import estimator_of
from multicontact_control.force.noise import lead_filter
import numpy as np
import pytest
from scipy.signal import dimpulse, freqz, lfilter, lfilter_zi

RATE = 500.0


@pytest.mark.parametrize(('normalisation', 'at_dc', 'at_nyquist', 'factor'), [
    ('dc', 1.0, 19.1, 269.0), ('hf', 1.0 / 19.1, 1.0, 269.0 / 366.0)])
def test_lead_filter_has_the_papers_gains(normalisation, at_dc, at_nyquist, factor):
    """Zero and pole at 3 and 60 Hz, and what is left of white noise (paper notes 6)."""
    f = lead_filter(3.0, 60.0, RATE, normalisation)
    numerator, denominator = [f.gain, -f.gain * f.zero], [1.0, -f.pole]
    np.testing.assert_allclose(
        -np.log([f.zero, f.pole]) * RATE / (2 * np.pi), [3.0, 60.0], rtol=1e-12)
    _, response = freqz(numerator, denominator, worN=[0.0, np.pi])
    np.testing.assert_allclose(np.abs(response), [at_dc, at_nyquist], rtol=0.01)
    _, (impulse,) = dimpulse((numerator, denominator, 1.0), n=400)
    assert f.variance_factor() == pytest.approx(float((impulse ** 2).sum()), rel=1e-12)
    assert f.variance_factor() == pytest.approx(factor, rel=0.01)


@pytest.mark.parametrize(('name', 'normalisation'), [
    ('window', None), ('lead_window', 'dc'), ('hf_window', 'hf')])
def test_window_is_the_variance_of_what_scipy_filters(name, normalisation):
    """From its steady state at the first sample, over 50 samples, known once there are 50."""
    estimator = estimator_of(name, contacts=2)
    forces = np.linspace(0.0, 30.0, 120)[:, None] + np.random.default_rng(15).standard_normal(
        (120, 2))
    filtered = forces
    if normalisation:
        f = lead_filter(3.0, 60.0, RATE, normalisation)
        numerator, denominator = [f.gain, -f.gain * f.zero], [1.0, -f.pole]
        zi = lfilter_zi(numerator, denominator)[:, None] * forces[0]
        filtered, _ = lfilter(numerator, denominator, forces, axis=0, zi=zi)
    values = np.array([estimator.update(force) for force in forces])
    assert (values[:49] == 0.6).all()
    np.testing.assert_allclose(
        values[49:], [filtered[k - 49:k + 1].var(axis=0) for k in range(49, 120)], rtol=1e-9)


def test_lead_window_finds_the_papers_variance_in_white_noise():
    """Raw noise of 0.047 N gives R = 0.6 N^2 (paper notes 6)."""
    estimator = estimator_of('lead_window', contacts=2)
    rng = np.random.default_rng(5)
    values = [estimator.update(10.0 + 0.0472 * rng.standard_normal(2)) for _ in range(20000)]
    np.testing.assert_allclose(np.mean(values[100:], axis=0), 0.6, rtol=0.05)


def test_lead_window_is_lifted_by_a_force_step():
    """A 10 N step alone lifts R to tens of N^2 and passes with the window (paper notes 6)."""
    estimator = estimator_of('lead_window', contacts=2)
    force = np.repeat([[2.0, 2.0], [12.0, 12.0]], [100, 200], axis=0)
    rise = np.exp(-np.arange(200) / 10.0)[:, None]  # the loop's 20 ms
    force[100:] -= 10.0 * rise * (1.0 + np.arange(200)[:, None] / 10.0)
    values = np.array([estimator.update(f) for f in force])
    assert (values[60:100] == 1e-3).all()
    assert 15.0 < values[:, 0].max() < 80.0
    assert values[-1, 0] < 0.1
