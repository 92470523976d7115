"""What the noise estimators do at every sample, compiled; all contacts at once."""

from __future__ import annotations

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled


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
