"""R as the windowed variance of the force, filtered or not (P04 eqs 42-44)."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Literal, Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.force.noise.base import (
    Innovation,
    MAX_MAGNITUDE,
    NoiseEstimator,
)
from multicontact_control.records import (
    Record,
    record_dtype,
    Records,
)
import numpy as np

Normalisation = Literal['dc', 'hf']


class NoiseWindow(Record, Protocol):
    """What is set for an estimator over a window (P04 eqs 42-44); one."""

    # A, c and b of the filter.
    pole: float
    zero: float
    gain: float

    scale: float  # of the variances
    count: int  # samples so far


NOISE_WINDOW = record_dtype(NoiseWindow)


class FilterState(Record, Protocol):
    """What the filter of one contact remembers of the sample before."""

    # [N].
    alpha: float
    filtered: float


FILTER_STATE = record_dtype(FilterState)


@dataclass(frozen=True, slots=True)
class LeadFilter:
    """alpha_f,k = a alpha_f,k-1 + b (alpha_k - c alpha_k-1): G_f of P04 eq. 42, matched z."""

    pole: float  # a
    zero: float  # c
    gain: float  # b


def design_lead_filter(
    zero_frequency: float,
    pole_frequency: float,
    rate: float,
    normalisation: Normalisation = 'dc',
) -> LeadFilter:
    """
    Design G_f (P04 eq. 42).

    With a DC gain of 1, as the paper says, a zero below the pole makes it a lead, which amplifies
    noise. With a gain of 1 at half the rate it is a high-pass filter.

    Frequencies of the continuous filter [Hz] are mapped by z = exp(-2 pi f h), h = 1 / rate.
    """
    zero = math.exp(-2.0 * math.pi * zero_frequency / rate)
    pole = math.exp(-2.0 * math.pi * pole_frequency / rate)
    if normalisation == 'dc':
        gain = (1.0 - pole) / (1.0 - zero)
    else:
        gain = (1.0 + pole) / (1.0 + zero)
    return LeadFilter(pole=pole, zero=zero, gain=gain)


@compiled
def take_into_window(
    alpha: Vector,
    windows: Records[NoiseWindow],
    states: Records[FilterState],
    samples: Matrix,
    variance: Vector,
) -> bool:
    """
    Filter one sample per contact, and estimate R once the window is full (P04 eqs 42-44).

    alpha_f,k = a alpha_f,k-1 + b (alpha_k - c alpha_k-1), from the steady state of the first
    sample; R is the variance of the filtered samples, shape (N, r). Returns False, nothing
    changed, for forces that cannot be used. Forces [N] and variance [N^2] are of shape (r,),
    `windows` is one record of `NOISE_WINDOW`, `states` are records of `FILTER_STATE`.
    """
    window = windows[0]
    length, contacts = samples.shape
    for i in range(contacts):
        if not abs(alpha[i]) < MAX_MAGNITUDE:  # nor is NaN
            return False
    if window.count == 0:
        for i in range(contacts):
            states[i].alpha = alpha[i]
            rest_gain = window.gain * (1.0 - window.zero) / (1.0 - window.pole)
            states[i].filtered = rest_gain * alpha[i]
    for i in range(contacts):
        state = states[i]
        state.filtered = window.pole * state.filtered + window.gain * (
            alpha[i] - window.zero * state.alpha
        )
        state.alpha = alpha[i]
        samples[window.count % length, i] = state.filtered
    window.count += 1
    if window.count < length:
        return True
    for i in range(contacts):
        total = 0.0
        for k in range(length):
            total += samples[k, i]
        mean = total / length
        total = 0.0
        for k in range(length):
            deviation = samples[k, i] - mean
            total += deviation * deviation
        variance[i] = window.scale * (total / length)
    return True


class Window(NoiseEstimator):
    """The variance of the force itself over the window, known once the window is full."""

    def _forget(self) -> None:
        config = self.config
        design = self._design()
        self._window = np.zeros(1, dtype=NOISE_WINDOW)
        for name in ('pole', 'zero', 'gain'):
            self._window[name] = getattr(design, name)
        self._window['scale'] = config.variance_scale
        self._states = np.zeros(self._contacts, dtype=FILTER_STATE)
        self._samples: Matrix = np.zeros((config.window, self._contacts))
        take_into_window(  # so that no sample waits for it to be compiled
            self._alpha,
            self._window.copy(),
            self._states.copy(),
            self._samples.copy(),
            self._variance.copy(),
        )

    def _design(self) -> LeadFilter:
        return LeadFilter(pole=0.0, zero=0.0, gain=1.0)  # what comes in goes out

    def _take(self, innovation: Innovation | None) -> bool:
        return bool(
            take_into_window(
                self._alpha, self._window, self._states, self._samples, self._variance
            )
        )


class LeadWindow(Window):
    """The paper's estimator: lead filter of unit gain at DC, then windowed variance."""

    normalisation: Normalisation = 'dc'

    def _design(self) -> LeadFilter:
        return design_lead_filter(
            self.config.zero_frequency,
            self.config.pole_frequency,
            self.config.rate,
            self.normalisation,
        )


class HfWindow(LeadWindow):
    """The other reading of the paper: the same filter with unit gain at high frequency."""

    normalisation: Normalisation = 'hf'
