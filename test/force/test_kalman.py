"""The compiled Kalman update: its equations, and its covariance over many updates."""

from force_loop import observer_of
from multicontact_control.force.observer import correct, predict
from multicontact_control.records import MAX_ORDER
from numba import njit
import numpy as np
import pytest

FLOOR, CEILING = 1e-3, 1e6  # the defaults of NoiseEstimatorConfig
UPDATES = 300_000


@njit
def _smallest_pivot(P):
    """Return the smallest pivot of P's Cholesky factor, each relative to the diagonal of P."""
    n = P.shape[0]
    L = np.zeros((n, n))
    smallest = np.inf
    for j in range(n):
        pivot = P[j, j]
        for k in range(j):
            pivot -= L[j, k] ** 2
        smallest = min(smallest, pivot / P[j, j])
        if not pivot > 0.0:
            return min(smallest, 0.0)
        L[j, j] = np.sqrt(pivot)
        for i in range(j + 1, n):
            total = P[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total / L[j, j]
    return smallest


@njit
def _run(observers, noise, variances):
    """
    Close the loop over the plant the filter models, with 10 N as command and noise on top.

    Returns the worst pivot and asymmetry of P after any update, and the largest force.
    """
    pivot, asymmetry, largest = np.inf, 0.0, 0.0
    n = 2 + 3  # states of the plant: the active ones come after
    plant = np.zeros(n)
    observer = observers[0]
    size = observer.states
    observer.command = 10.0 * observer.feedback[0]
    for k in range(noise.shape[0]):
        predict(observer)
        correct(observer, plant[0] + noise[k] - observer.x_1[0], variances[k])
        u = observer.command
        for i in range(size):
            u -= observer.feedback[i] * observer.x_est[i]
        plant = observer.Phi_n[:n, :n].copy() @ plant + observer.Gamma[:n] * u
        P = observer.P[:size, :size].copy()
        pivot = min(pivot, _smallest_pivot(P))
        largest = max(largest, abs(plant[0]))
        for i in range(size):
            for j in range(i):
                asymmetry = max(asymmetry, abs(P[i, j] - P[j, i]))
    return pivot, asymmetry, largest


def _jumping_variance(rng):
    """R at floor or ceiling: changing every tick, at random times, and every 20 000 ticks."""
    third = UPDATES // 3 + 1
    high = np.concatenate([
        np.arange(third) % 2, np.cumsum(rng.random(third) < 0.01) % 2,
        np.arange(third) // 20000 % 2])[:UPDATES]
    return np.where(high, CEILING, FLOOR)


@pytest.mark.parametrize('damping_rate', [0.0, 20.0])
@pytest.mark.parametrize('order', range(MAX_ORDER + 1))
def test_covariance_stays_symmetric_and_positive(order, damping_rate):
    rng = np.random.default_rng(11)
    observer = observer_of(order, damping_rate)
    variances = _jumping_variance(rng)
    noise = rng.standard_normal(UPDATES) * np.minimum(np.sqrt(variances), 1.0)
    pivot, asymmetry, largest = _run(observer.records, noise, variances)
    assert asymmetry == 0.0
    # Rounding reaches the pivots at about 1e-16: one far above it is positive for good.
    assert pivot > 1e-9
    assert largest < 1e3
    # And P is not only positive but right: a fresh filter ends where this one does.
    fresh = observer_of(order, damping_rate)
    for filter_ in (observer, fresh):
        _run(filter_.records, np.zeros(20000), np.full(20000, 0.6))
    np.testing.assert_allclose(observer.P, fresh.P, rtol=1e-6, atol=1e-15)
