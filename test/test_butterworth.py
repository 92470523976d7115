"""The product's own design of a low-pass is that of scipy, to the last bit."""

from multicontact_control.butterworth import butterworth
import numpy as np
import pytest
from scipy.signal import butter


@pytest.mark.parametrize('order', [1, 2])
def test_coefficients_are_scipys(order):
    rng = np.random.default_rng(0)
    for rate in (500.0, 1000.0, 4000.0, *rng.uniform(100.0, 1e4, 20)):
        for cutoff in (31.25, *rng.uniform(1.0, 0.49 * rate, 20)):
            if cutoff < 0.5 * rate:
                found, expected = butterworth(order, cutoff, rate), butter(order, cutoff, fs=rate)
                np.testing.assert_array_equal(found[0], expected[0])
                np.testing.assert_array_equal(found[1], expected[1])
