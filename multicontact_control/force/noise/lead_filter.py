"""The first-order filter before the paper's windowed variance (P04 eq. 42)."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Literal

Normalisation = Literal['dc', 'hf']


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

    @property
    def dc_gain(self) -> float:
        """Gain for a constant force."""
        return self.gain * (1.0 - self.zero) / (1.0 - self.pole)


def lead_filter(
    zero_frequency: float, pole_frequency: float, rate: float, normalisation: Normalisation = 'dc',
) -> LeadFilter:
    """
    Design G_f (P04 eq. 42).

    With a DC gain of 1, as the paper says, a zero below the pole makes it a lead, which
    amplifies white noise. With a gain of 1 at half the rate it is a high-pass filter.

    Parameters
    ----------
    zero_frequency, pole_frequency
        Of the continuous filter, mapped by z = exp(-2 pi f h) [Hz].
    rate
        1/h [Hz].
    normalisation
        Where the gain is 1: at DC or at half the rate.

    """
    zero = math.exp(-2.0 * math.pi * zero_frequency / rate)
    pole = math.exp(-2.0 * math.pi * pole_frequency / rate)
    gain = (1.0 - pole) / (1.0 - zero) if normalisation == 'dc' else (1.0 + pole) / (1.0 + zero)
    return LeadFilter(pole=pole, zero=zero, gain=gain)
