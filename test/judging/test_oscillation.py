"""Limit cycles are found, noise and transients are not."""

from multicontact_control.judging.oscillation import find_oscillations
import numpy as np
import pytest
from scipy.signal import lfilter

RATE = 500.0
TIME = np.arange(3000) / RATE
COMMAND = np.full(TIME.shape, 10.0)


def tone(frequency, rms):
    amplitude = rms * np.sqrt(2.0)
    return amplitude * np.sin(2.0 * np.pi * frequency * TIME)


def noise(rms, seed=0, colour=0.0):
    """Return noise, of which each sample keeps a share `colour` of the one before."""
    white = np.random.default_rng(seed).standard_normal(TIME.shape)
    values = lfilter([1.0], [1.0, -colour], white)
    return rms * values / values.std()


def detect(error, judged=TIME >= 0.0, command=COMMAND):
    return find_oscillations(error, command, judged, RATE)


@pytest.mark.parametrize('frequency', [11.0, 14.0, 42.0, 180.0])
def test_limit_cycle_in_noise_is_detected_with_its_frequency_and_size(frequency):
    (one,) = detect(tone(frequency, 0.8) + noise(0.5))
    assert one.frequency == pytest.approx(frequency, abs=1.0)
    assert one.rms == pytest.approx(0.8, rel=0.15)
    assert one.recognised_at == pytest.approx(2.0, abs=0.01)
    assert one.duration == pytest.approx(6.0, abs=0.3)


@pytest.mark.parametrize('colour', [0.0, 0.8, 0.95, 0.98])
@pytest.mark.parametrize('seed', range(3))
def test_noise_of_any_colour_is_no_oscillation(seed, colour):
    assert detect(noise(3.0, seed, colour)) == []


@pytest.mark.parametrize(('lasting', 'count'), [(1.0, 0), (2.1, 1)])
def test_oscillation_lasts_two_seconds(lasting, count):
    error = tone(42.0, 2.0)
    error[TIME < 1.0] = 0.0
    error[TIME >= 1.0 + lasting] = 0.0
    assert len(detect(error)) == count


def test_tone_that_is_small_slow_not_judged_or_not_asked_for_is_left_out():
    assert detect(tone(42.0, 0.3)) != []
    assert detect(tone(42.0, 0.2)) == []
    assert detect(tone(2.0, 3.0)) == []
    assert detect(tone(42.0, 0.08), command=0.1 * COMMAND) == []
    assert detect(tone(42.0, 5.0), command=0.0 * COMMAND) == []
    assert detect(tone(42.0, 5.0), judged=TIME < 1.5) == []


def hide_samples(error):
    """Return the error with single samples missing, and 30 ms every two seconds."""
    seen = error.copy()
    single = np.random.default_rng(1).random(TIME.shape) < 0.05
    gaps = abs(TIME % 2.0 - 0.515) < 0.015
    seen[single | gaps] = np.nan
    return seen


def test_gaps_alone_are_no_oscillation_and_hide_none():
    assert detect(hide_samples(noise(1.0) + tone(0.5, 2.1))) == []
    (one,) = detect(hide_samples(tone(42.0, 2.0)))
    assert one.frequency == pytest.approx(42.0, abs=1.0)
