"""Estimating the variance R_k of the force noise on-line (P04 sec. 4.2)."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Protocol

from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.config import NoiseEstimatorConfig
import numpy as np


class NoiseEstimator(Protocol):
    """Samples in, variances out, one per contact."""

    dropped: int

    def update(self, alpha: Vector) -> Vector:
        """
        Take in the force of one tick.

        Parameters
        ----------
        alpha
            Measured forces, shape (r,) [N]. A sample that is not finite is dropped and counted
            in `dropped`.

        Returns
        -------
        Vector
            R for the next tick, shape (r,) [N^2].

        """
        ...

    def reset(self) -> None:
        """Forget all samples."""
        ...


@dataclass(frozen=True, slots=True)
class LeadFilter:
    """
    alpha_f,k = a alpha_f,k-1 + b (alpha_k - c alpha_k-1): G_f of P04 eq. 42, matched z.

    Attributes
    ----------
    pole, zero, gain
        a, c and b.

    """

    pole: float
    zero: float
    gain: float

    def variance_factor(self) -> float:
        """Variance of the output for white noise of unit variance at the input."""
        a, c, b = self.pole, self.zero, self.gain
        return b * b * (1.0 + (a - c) ** 2 / (1.0 - a * a))


def lead_filter(zero_frequency: float, pole_frequency: float, rate: float) -> LeadFilter:
    """
    Design G_f with a DC gain of 1 (P04 eq. 42).

    A zero below the pole makes it a lead: with 3 and 60 Hz at 500 Hz its gain rises
    to 19 and white noise leaves it with 269 times its variance.

    Parameters
    ----------
    zero_frequency, pole_frequency
        Of the continuous filter, mapped by z = exp(-2 pi f h) [Hz].
    rate
        1/h [Hz].

    """
    zero = math.exp(-2.0 * math.pi * zero_frequency / rate)
    pole = math.exp(-2.0 * math.pi * pole_frequency / rate)
    return LeadFilter(pole=pole, zero=zero, gain=(1.0 - pole) / (1.0 - zero))


class WindowedVariance:
    """
    Variance over the last N samples (P04 eqs 43-44), one per contact.

    Recomputed from the samples each time: a running sum would keep the rounding of every large
    sample for ever.

    Parameters
    ----------
    window
        N.
    contacts
        r.

    """

    def __init__(self, window: int, contacts: int) -> None:
        self._samples: Matrix = np.zeros((window, contacts))
        self._count = 0

    @property
    def full(self) -> bool:
        """Whether N samples have come."""
        return self._count >= self._samples.shape[0]

    def update(self, samples: Vector) -> Vector:
        """
        Take in one sample per contact.

        Returns
        -------
        Vector
            Variance over the samples there are, shape (r,).

        """
        self._samples[self._count % self._samples.shape[0]] = samples
        self._count += 1
        known = self._samples[:self._count] if not self.full else self._samples
        deviation = known - known.sum(axis=0) / known.shape[0]
        variance: Vector = (deviation * deviation).sum(axis=0) / known.shape[0]
        return variance


class LeadWindow:
    """
    The paper's estimator: lead filter, then windowed variance (P04 eqs 42-44).

    The filter starts from the first sample as its steady state. Until the window is full the
    configured fixed variance is given out.

    Parameters
    ----------
    config
        Window, filter, limits.

    """

    def __init__(self, config: NoiseEstimatorConfig) -> None:
        self._config = config
        self._filter = lead_filter(config.zero_frequency, config.pole_frequency, config.rate)
        self.dropped = 0
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        count = len(self._config.contact_names)
        self._window = WindowedVariance(self._config.window, count)
        self._previous: Vector | None = None
        self._filtered: Vector = np.zeros(count)
        self._variance: Vector = np.full(count, self._config.fixed_variance)

    def update(self, alpha: Vector) -> Vector:
        """
        Take in the force of one tick.

        Parameters
        ----------
        alpha
            Measured forces, shape (r,) [N].

        Returns
        -------
        Vector
            R for the next tick, shape (r,) [N^2], within floor and ceiling.

        Raises
        ------
        ShapeError
            If `alpha` is not of shape (r,).

        """
        require_shape('alpha', alpha, self._variance.shape)
        if not np.isfinite(alpha).all():
            self.dropped += 1
            return self._variance.copy()
        if self._previous is None:
            self._previous = alpha.copy()
            self._filtered = alpha.copy()
        f = self._filter
        self._filtered = f.pole * self._filtered + f.gain * (alpha - f.zero * self._previous)
        self._previous = alpha.copy()
        variance = self._window.update(self._filtered)
        if self._window.full:
            self._variance = np.clip(
                variance, self._config.variance_floor, self._config.variance_ceiling)
        return self._variance.copy()


class FixedVariance:
    """
    R as configured, whatever the samples: the baseline the paper calls unstable in motion.

    Parameters
    ----------
    config
        The variance and its limits.

    """

    def __init__(self, config: NoiseEstimatorConfig) -> None:
        self._variance = np.full(len(config.contact_names), np.clip(
            config.fixed_variance, config.variance_floor, config.variance_ceiling))
        self.dropped = 0

    def reset(self) -> None:
        """Do nothing: there is nothing to forget."""

    def update(self, alpha: Vector) -> Vector:
        """
        Take in the force of one tick.

        Raises
        ------
        ShapeError
            If `alpha` is not of shape (r,).

        """
        require_shape('alpha', alpha, self._variance.shape)
        if not np.isfinite(alpha).all():
            self.dropped += 1
        return self._variance.copy()


def make_noise_estimator(config: NoiseEstimatorConfig) -> NoiseEstimator:
    """Return the estimator a configuration names, in its initial state."""
    estimators: dict[str, type[LeadWindow] | type[FixedVariance]] = {
        'lead_window': LeadWindow, 'fixed': FixedVariance}
    return estimators[config.estimator](config)
