"""The estimator `variational_bayes`: a distribution of R, updated by each innovation."""

from __future__ import annotations

from multicontact_control.arrays import Mask, Vector
from multicontact_control.force.noise.base import Innovation
from multicontact_control.force.noise.innovation import (
    corrected_square,
    InnovationEstimator,
)
import numpy as np

ITERATIONS = 3  # per sample


class VariationalBayes(InnovationEstimator):
    """
    Shape a and scale b of R's inverse gamma distribution (Sarkka and Nummenmaa 2009); R = b / a.

    a^-, b^- = rho a, rho b; a = a^- + 1/2; then, a few times, b = b^- + e^2/2 + C P C^T/2 with
    e and C P C^T for R = b / a. The prediction is the observer's, the correction in these
    iterations is the estimator's own: the observer itself works with the R of the tick before.
    A contact starts at R = `fixed_variance` with the weight of a full memory, a = 1/(2 (1-rho)).
    """

    def _forget(self) -> None:
        weight = 0.5 / (1.0 - self._kept)
        self._shape: Vector = np.full(self._contacts, weight)
        self._scale: Vector = weight * self._variance / self.config.variance_scale

    def _estimate_from(self, innovation: Innovation) -> tuple[Vector, Mask]:
        valid = innovation.valid
        rho = self._kept
        shape = np.where(valid, rho * self._shape + 0.5, self._shape)
        prior = rho * self._scale
        scale = self._scale
        for _ in range(ITERATIONS):
            scale = prior + 0.5 * corrected_square(innovation, scale / shape)
        # Without the bound one wild sample would be remembered for thousands of ticks.
        scale = np.minimum(scale, shape * self._largest / self.config.variance_scale)
        self._shape = shape
        self._scale = np.where(valid, scale, self._scale)
        return self._scale / self._shape, valid
