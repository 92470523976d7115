"""The lead filter against scipy's filters and the paper's numbers (P04 eq. 42)."""

from multicontact_control.force.noise import lead_filter
from multicontact_control.force.noise.kernels import advance_filter
from multicontact_control.records import FILTER_STATE, NOISE_WINDOW
import numpy as np
import pytest
from scipy.signal import dimpulse, freqz, lfilter, lfilter_zi

RATE = 500.0


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


def test_lead_filter_normalised_at_high_frequency_is_the_same_filter_scaled():
    """Unit gain at half the rate; a twentieth is left at DC (paper notes 6)."""
    dc, hf = (lead_filter(3.0, 60.0, RATE, normalisation) for normalisation in ('dc', 'hf'))
    assert (hf.pole, hf.zero) == (dc.pole, dc.zero)
    _, response = freqz([hf.gain, -hf.gain * hf.zero], [1.0, -hf.pole], worN=[0.0, np.pi])
    assert abs(response[1]) == pytest.approx(1.0, rel=1e-12)
    assert abs(response[0]) == pytest.approx(hf.dc_gain, rel=1e-12)
    assert dc.dc_gain == pytest.approx(1.0, rel=1e-12)
    assert hf.variance_factor() == pytest.approx(
        dc.variance_factor() * (hf.gain / dc.gain) ** 2, rel=1e-12)


@pytest.mark.parametrize('normalisation', ['dc', 'hf'])
def test_running_lead_filter_is_scipys_from_its_steady_state(normalisation):
    """No transient from the first sample."""
    f = lead_filter(3.0, 60.0, RATE, normalisation)
    samples = np.random.default_rng(9).standard_normal((40, 2)) + [10.0, -3.0]
    numerator, denominator = [f.gain, -f.gain * f.zero], [1.0, -f.pole]
    zi = lfilter_zi(numerator, denominator)[:, None] * samples[0]
    expected, _ = lfilter(numerator, denominator, samples, axis=0, zi=zi)
    window, states = np.zeros(1, dtype=NOISE_WINDOW), np.zeros(2, dtype=FILTER_STATE)
    window['pole'], window['zero'], window['gain'] = f.pole, f.zero, f.gain
    states['alpha'], states['filtered'] = samples[0], f.dc_gain * samples[0]
    for sample, wanted in zip(samples, expected):
        advance_filter(window[0], states, sample)
        np.testing.assert_allclose(states['filtered'], wanted, rtol=1e-10, atol=1e-12)
