"""The estimator `sage_husa`: a recursive mean over the corrected innovations."""

from __future__ import annotations

from multicontact_control.arrays import Mask, Vector
from multicontact_control.force.noise.base import Innovation
from multicontact_control.force.noise.innovation import (
    corrected_square,
    InnovationEstimator,
)
import numpy as np


class SageHusa(InnovationEstimator):
    """
    Sage and Husa: R_k = (1 - d_k) R_k-1 + d_k (e e^T + C P C^T), d_k = (1 - b) / (1 - b^k).

    d_1 = 1: the first innovation of a contact alone makes its first R, and d_k falls towards
    1 - b as more come. k counts each contact's own innovations.
    """

    def _forget(self) -> None:
        self._count = np.zeros(self._contacts)
        self._mean: Vector = np.zeros(self._contacts)

    def _estimate_from(self, innovation: Innovation) -> tuple[Vector, Mask]:
        valid = innovation.valid
        b = self._kept
        self._count = self._count + valid
        weight = (1.0 - b) / (1.0 - b ** np.maximum(self._count, 1.0))
        term = corrected_square(innovation, innovation.variance_used)
        # Without the bound one wild sample would be remembered for thousands of ticks.
        mean = np.minimum(
            (1.0 - weight) * self._mean + weight * term,
            self._largest / self.config.variance_scale,
        )
        self._mean = np.where(valid, mean, self._mean)
        return self._mean, valid
