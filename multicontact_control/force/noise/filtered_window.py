"""R as the windowed variance of the force, filtered or not (P04 eqs 42-44)."""

from __future__ import annotations

from multicontact_control.arrays import Matrix
from multicontact_control.force.noise.estimator import MAX_MAGNITUDE, NoiseEstimator
from multicontact_control.force.noise.innovation import Innovation
from multicontact_control.force.noise.kernels import take_into_window
from multicontact_control.force.noise.lead_filter import lead_filter, LeadFilter, Normalisation
import numpy as np


class Window(NoiseEstimator):
    """The variance of the force itself over the window, known once the window is full."""

    def _forget(self) -> None:
        design = self._design()
        self._filter = np.array([design.pole, design.zero, design.gain, design.dc_gain])
        self._memory: Matrix = np.zeros((2, self._contacts))
        self._samples: Matrix = np.zeros((self.config.window, self._contacts))
        self._count = 0

    def _design(self) -> LeadFilter:
        return LeadFilter(pole=0.0, zero=0.0, gain=1.0)  # what comes in goes out

    def _take(self, innovation: Innovation | None) -> bool:
        usable = take_into_window(
            self._alpha, MAX_MAGNITUDE, self._filter, self._memory, self._samples, self._count,
            *self._limits, self._variance)
        self._count += usable
        return usable


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
