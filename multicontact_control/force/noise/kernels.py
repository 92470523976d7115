"""What the noise estimators do at every sample, compiled; all contacts at once."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np


@compiled
def all_below(values: Vector, limit: float) -> bool:
    """Return whether all magnitudes are below a limit; what is not a number is not."""
    for i in range(values.shape[0]):
        if not abs(values[i]) < limit:
            return False
    return True


@compiled
def advance_filter(window: Any, states: Any, alpha: Vector) -> None:
    """
    Take one sample per contact into a first-order filter.

    alpha_f,k = a alpha_f,k-1 + b (alpha_k - c alpha_k-1) (P04 eq. 42).

    Parameters
    ----------
    window
        Record of `NOISE_WINDOW`.
    states
        Records of `FILTER_STATE`, changed, shape (r,).
    alpha
        alpha_k, shape (r,) [N].

    """
    for i in range(alpha.shape[0]):
        state = states[i]
        state.filtered = window.pole * state.filtered + window.gain * (
            alpha[i] - window.zero * state.alpha)
        state.alpha = alpha[i]


@compiled
def windowed_variance(samples: Matrix, count: int, variance: Vector) -> None:
    """
    Fill in the variance over the samples in a window (P04 eqs 43-44).

    Parameters
    ----------
    samples
        The window; its first `count` rows are known, shape (N, r).
    count
        At least 1.
    variance
        Filled, shape (r,).

    """
    for i in range(samples.shape[1]):
        total = 0.0
        for k in range(count):
            total += samples[k, i]
        mean = total / count
        total = 0.0
        for k in range(count):
            deviation = samples[k, i] - mean
            total += deviation * deviation
        variance[i] = total / count


@compiled
def settle_variance(
    estimate: Vector, known: Mask, scale: float, floor: float, ceiling: float, variance: Vector,
) -> None:
    """
    Replace the variances that are known, scaled and within their limits.

    Parameters
    ----------
    estimate, known
        Estimated variances and which of them are known, shape (r,).
    scale, floor, ceiling
        See `NoiseEstimatorConfig`.
    variance
        R, overwritten, shape (r,) [N^2].

    """
    for i in range(variance.shape[0]):
        if known[i]:
            variance[i] = min(max(scale * estimate[i], floor), ceiling)


@compiled
def take_into_window(
    alpha: Vector, windows: Any, states: Any, samples: Matrix, variance: Vector,
) -> bool:
    """
    Filter one sample per contact, and estimate R once the window is full (P04 eqs 42-44).

    The first sample is the filter's steady state.

    Parameters
    ----------
    alpha
        Forces, shape (r,) [N].
    windows
        One record of `NOISE_WINDOW`; its count is raised.
    states
        Records of `FILTER_STATE`, changed, shape (r,).
    samples
        Window of filtered forces, overwritten in turn, shape (N, r).
    variance
        R, overwritten once the window is full, shape (r,) [N^2].

    Returns
    -------
    bool
        Whether the forces could be used; if not, nothing has changed.

    """
    window = windows[0]
    if not all_below(alpha, window.largest):
        return False
    length, contacts = samples.shape
    if window.count == 0:
        for i in range(contacts):
            states[i].alpha = alpha[i]
            states[i].filtered = window.dc_gain * alpha[i]
    advance_filter(window, states, alpha)
    for i in range(contacts):
        samples[window.count % length, i] = states[i].filtered
    window.count += 1
    if window.count >= length:
        estimate = np.empty(contacts)
        windowed_variance(samples, length, estimate)
        settle_variance(estimate, np.ones(contacts, dtype=np.bool_), window.scale, window.floor,
                        window.ceiling, variance)
    return True
