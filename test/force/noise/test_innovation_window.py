"""Statistics of the window against numpy's over the same samples (P04 eqs 43-44)."""

from multicontact_control.force.noise import WindowedMean
from multicontact_control.force.noise.kernels import windowed_variance
import numpy as np


def test_windowed_variance_is_numpys_over_the_known_samples():
    """Equations 43-44 with 1/N."""
    samples = np.random.default_rng(4).standard_normal((50, 2)) + [1e3, -5.0]
    variance = np.empty(2)
    for count in range(1, 51):
        windowed_variance(samples, count, variance)
        np.testing.assert_allclose(
            variance, samples[:count].var(axis=0), rtol=1e-9, atol=1e-12)


def test_windowed_mean_counts_each_contact_s_own_samples():
    """A contact that misses samples keeps those it has."""
    rng = np.random.default_rng(10)
    samples, valid = rng.standard_normal((300, 2)), rng.random((300, 2)) < [1.0, 0.3]
    window = WindowedMean(50, 2)
    for k, (sample, mask) in enumerate(zip(samples, valid)):
        mean = window.update(sample, mask)
        for i in range(2):
            own = samples[:k + 1, i][valid[:k + 1, i]]
            assert window.full[i] == (len(own) >= 50)
            if window.full[i]:
                np.testing.assert_allclose(mean[i], own[-50:].mean(), rtol=1e-12, atol=1e-15)
