"""Statistics of the window against numpy's over the same samples (P04 eqs 43-44)."""

import numpy as np

from multicontact_control.force.noise import WindowedMean, WindowedVariance


def test_windowed_variance_is_numpys_over_the_last_samples():
    """Equations 43-44 with 1/N."""
    samples = np.random.default_rng(4).standard_normal((137, 2)) + [1e3, -5.0]
    window = WindowedVariance(50, 2)
    for k, sample in enumerate(samples):
        variance = window.update(sample)
        np.testing.assert_allclose(
            variance, samples[max(0, k - 49):k + 1].var(axis=0), rtol=1e-9, atol=1e-12)
    assert window.full


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
