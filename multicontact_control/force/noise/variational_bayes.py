"""R as an inverse gamma distribution, by variational Bayes (Sarkka and Nummenmaa 2009)."""

from __future__ import annotations

from multicontact_control.arrays import Mask, Vector
from multicontact_control.force.noise.estimator import InnovationEstimator
from multicontact_control.force.noise.innovation import Innovation
import numpy as np


class VariationalBayes(InnovationEstimator):
    """
    Shape a and scale b of R's inverse gamma distribution; R = b / a.

    a^-, b^- = rho a, rho b; a = a^- + 1/2; then, a few times, b = b^- + e^2/2 + C P C^T/2 with
    e and C P C^T for R = b / a. The prediction is the observer's, the correction in these
    iterations is the estimator's own: the observer itself works with the R of the tick before.
    A contact starts at R = `fixed_variance` with the weight of a full memory, a = 1/(2 (1-rho)).
    """

    def _forget(self) -> None:
        weight = 0.5 / (1.0 - self.config.bayes_decay)
        self._shape: Vector = np.full(self._contacts, weight)
        self._scale: Vector = weight * self._variance / self.config.variance_scale

    def _estimate_from(self, innovation: Innovation) -> tuple[Vector, Mask]:
        valid = innovation.valid
        rho = self.config.bayes_decay
        shape = np.where(valid, rho * self._shape + 0.5, self._shape)
        prior = rho * self._scale
        scale = self._scale
        for _ in range(self.config.bayes_iterations):
            share = Innovation(innovation.innovation, innovation.prior_variance, scale / shape)
            scale = prior + 0.5 * (share.residual ** 2 + share.posterior_variance)
        # Without the bound one wild sample would be remembered for thousands of ticks.
        scale = np.minimum(
            scale, shape * self.config.variance_ceiling / self.config.variance_scale)
        self._shape = shape
        self._scale = np.where(valid, scale, self._scale)
        return self._scale / self._shape, valid
