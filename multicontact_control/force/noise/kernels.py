"""What the noise estimators do at every sample, compiled; all contacts at once."""

from __future__ import annotations

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
def advance_filter(
    pole: float, zero: float, gain: float, previous: Vector, alpha: Vector, filtered: Vector,
) -> None:
    """
    Take one sample per contact into a first-order filter.

    alpha_f,k = a alpha_f,k-1 + b (alpha_k - c alpha_k-1) (P04 eq. 42).

    Parameters
    ----------
    pole, zero, gain
        a, c and b.
    previous, alpha
        alpha_k-1, overwritten with alpha_k, and alpha_k, shape (r,) [N].
    filtered
        alpha_f, overwritten, shape (r,) [N].

    """
    for i in range(alpha.shape[0]):
        filtered[i] = pole * filtered[i] + gain * (alpha[i] - zero * previous[i])
        previous[i] = alpha[i]


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
    alpha: Vector, limit: float, design: Vector, memory: Matrix, samples: Matrix, count: int,
    scale: float, floor: float, ceiling: float, variance: Vector,
) -> bool:
    """
    Filter one sample per contact, and estimate R once the window is full (P04 eqs 42-44).

    The first sample is the filter's steady state.

    Parameters
    ----------
    alpha, limit
        Forces [N], shape (r,), and what their magnitudes must be below.
    design
        Pole, zero, gain and gain at DC of the filter.
    memory
        The force and the filtered force of the tick before, overwritten, shape (2, r).
    samples, count
        Window of filtered forces, overwritten in turn, shape (N, r), and how many samples have
        come before this one.
    scale, floor, ceiling, variance
        As for `settle_variance`.

    Returns
    -------
    bool
        Whether the forces could be used; if not, nothing has changed.

    """
    if not all_below(alpha, limit):
        return False
    window, contacts = samples.shape
    previous, filtered = memory[0], memory[1]
    if count == 0:
        for i in range(contacts):
            previous[i] = alpha[i]
            filtered[i] = design[3] * alpha[i]
    advance_filter(design[0], design[1], design[2], previous, alpha, filtered)
    for i in range(contacts):
        samples[count % window, i] = filtered[i]
    if count + 1 >= window:
        estimate = np.empty(contacts)
        windowed_variance(samples, window, estimate)
        settle_variance(estimate, np.ones(contacts, dtype=np.bool_), scale, floor, ceiling,
                        variance)
    return True
