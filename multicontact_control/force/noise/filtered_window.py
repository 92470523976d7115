"""R as the windowed variance of the force, filtered or not (P04 eqs 42-44)."""

from __future__ import annotations

from multicontact_control.arrays import Matrix
from multicontact_control.compiled import bound
from multicontact_control.force.noise.estimator import MAX_MAGNITUDE, NoiseEstimator
from multicontact_control.force.noise.innovation import Innovation
from multicontact_control.force.noise.kernels import take_into_window
from multicontact_control.force.noise.lead_filter import lead_filter, LeadFilter, Normalisation
from multicontact_control.records import FILTER_STATE, NOISE_WINDOW
import numpy as np


class Window(NoiseEstimator):
    """The variance of the force itself over the window, known once the window is full."""

    def _forget(self) -> None:
        design = self._design()
        self._window = np.zeros(1, dtype=NOISE_WINDOW)
        for name in ('pole', 'zero', 'gain', 'dc_gain'):
            self._window[name] = getattr(design, name)
        self._window['largest'] = MAX_MAGNITUDE
        for name, value in zip(('scale', 'floor', 'ceiling'), self._limits):
            self._window[name] = value
        self._states = np.zeros(self._contacts, dtype=FILTER_STATE)
        self._samples: Matrix = np.zeros((self.config.window, self._contacts))
        self._take_into_window = bound(
            take_into_window, self._alpha, self._window, self._states, self._samples,
            self._variance)

    def _design(self) -> LeadFilter:
        return LeadFilter(pole=0.0, zero=0.0, gain=1.0)  # what comes in goes out

    def _take(self, innovation: Innovation | None) -> bool:
        return bool(self._take_into_window(
            self._alpha, self._window, self._states, self._samples, self._variance))


class LeadWindow(Window):
    """The paper's estimator: lead filter of unit gain at DC, then windowed variance."""

    normalisation: Normalisation = 'dc'

    def _design(self) -> LeadFilter:
        return lead_filter(
            self.config.zero_frequency, self.config.pole_frequency, self.config.rate,
            self.normalisation)


class HfWindow(LeadWindow):
    """The other reading of the paper: the same filter with unit gain at high frequency."""

    normalisation: Normalisation = 'hf'
