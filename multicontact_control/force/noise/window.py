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
    """Filter, scale and sample count of an estimator over a window, one for all contacts."""

    # a, c and b of `LeadFilter`.
    pole: float
    zero: float
    gain: float

    scale: float  # factor of R, `variance_scale`
    count: int  # samples so far


NOISE_WINDOW = record_dtype(NoiseWindow)


class FilterState(Record, Protocol):
    """What the filter of one contact remembers of the sample before."""

    alpha: float  # what came in [N]
    filtered: float  # what went out [N]


FILTER_STATE = record_dtype(FilterState)


@dataclass(frozen=True, slots=True)
class LeadFilter:
    """
    A filter with one pole and one zero: G_f of P04 eq. 42, in discrete time.

    alpha_f,k = a alpha_f,k-1 + b (alpha_k - c alpha_k-1)
    """

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

    With a DC gain of 1 ('dc'), as the paper says, a zero below the pole makes it a lead, which
    amplifies noise. With a gain of 1 at half the rate ('hf') it is the same filter times a
    constant: with zero and pole at 3 and 60 Hz it lets 1/19 of a constant force through, and R is
    365 times smaller.

    Frequencies of the continuous filter [Hz] are mapped by z = exp(-2 pi f h), h = 1 / rate
    (matched z-transform).
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
    sample. R is the variance (with 1/N) of the newest N filtered forces.

    Parameters
    ----------
    alpha
        Measured forces, shape (r,) [N].
    windows
        One record of `NOISE_WINDOW`.
    states
        A record of `FILTER_STATE` for each contact.
    samples
        Keeps the newest N filtered forces in a ring, shape (N, r) [N].
    variance
        Becomes R times the scale, shape (r,) [N^2]. Before N samples it stays as it is.

    Returns
    -------
    bool
        False, with nothing changed, if a force is not finite or beyond `MAX_MAGNITUDE`.

    """
    window = windows[0]
    length, contacts = samples.shape
    for i in range(contacts):
        if not abs(alpha[i]) < MAX_MAGNITUDE:  # written so that it catches NaN, too
            return False
    if window.count == 0:
        rest_gain = window.gain * (1.0 - window.zero) / (1.0 - window.pole)
        for i in range(contacts):
            states[i].alpha = alpha[i]
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
    # Summed anew at each sample: a running sum would keep the rounding of every large force.
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


class WindowEstimator(NoiseEstimator):
    """
    The variance of the force itself over the newest `window` samples, once there are as many.

    A step of the force counts as noise until the window has passed it.
    """

    def _forget(self) -> None:
        config = self.config
        design = self._design()
        self._window = np.zeros(1, dtype=NOISE_WINDOW)
        for name in ('pole', 'zero', 'gain'):
            self._window[name] = getattr(design, name)
        self._window['scale'] = config.variance_scale
        self._states = np.zeros(self._contacts, dtype=FILTER_STATE)
        self._samples: Matrix = np.zeros((config.window, self._contacts))

    def _design(self) -> LeadFilter:
        return LeadFilter(pole=0.0, zero=0.0, gain=1.0)  # what comes in goes out

    def _take(self, innovation: Innovation | None) -> bool:
        return bool(
            take_into_window(
                self._alpha, self._window, self._states, self._samples, self._variance
            )
        )


class LeadWindowEstimator(WindowEstimator):
    """
    The paper's estimator: the variance of the force behind a lead filter of unit gain at DC.

    The lead amplifies what changes fast, above all noise (P04 sec. 4.2, eqs 42-44).
    """

    normalisation: Normalisation = 'dc'

    def _design(self) -> LeadFilter:
        return design_lead_filter(
            self.config.zero_frequency,
            self.config.pole_frequency,
            self.config.rate,
            self.normalisation,
        )


class HfWindowEstimator(LeadWindowEstimator):
    """The other reading of the paper: the same filter with unit gain at half the rate."""

    normalisation: Normalisation = 'hf'
