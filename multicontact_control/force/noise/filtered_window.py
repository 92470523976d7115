"""R as the windowed variance of the force, filtered or not (P04 eqs 42-44)."""

from __future__ import annotations

import numpy as np

from multicontact_control.arrays import Mask, Vector
from multicontact_control.force.noise.estimator import NoiseEstimator
from multicontact_control.force.noise.innovation import Innovation
from multicontact_control.force.noise.lead_filter import (
    lead_filter,
    Normalisation,
    RunningLeadFilter,
)
from multicontact_control.force.noise.windows import WindowedVariance


class Window(NoiseEstimator):
    """The variance of the force itself over the window, known once the window is full."""

    def _forget(self) -> None:
        self._window = WindowedVariance(self.config.window, self._contacts)
        self._all = np.ones(self._contacts, dtype=bool)
        self._none = np.zeros(self._contacts, dtype=bool)

    def _estimate(self, alpha: Vector, innovation: Innovation | None) -> tuple[Vector, Mask]:
        variance = self._window.update(alpha)
        return variance, self._all if self._window.full else self._none


class LeadWindow(Window):
    """The paper's estimator: lead filter of unit gain at DC, then windowed variance."""

    normalisation: Normalisation = 'dc'

    def _forget(self) -> None:
        super()._forget()
        self._filter = RunningLeadFilter(lead_filter(
            self.config.zero_frequency, self.config.pole_frequency, self.config.rate,
            self.normalisation))

    def _estimate(self, alpha: Vector, innovation: Innovation | None) -> tuple[Vector, Mask]:
        return super()._estimate(self._filter.update(alpha), innovation)


class HfWindow(LeadWindow):
    """The other reading of the paper: the same filter with unit gain at high frequency."""

    normalisation: Normalisation = 'hf'
