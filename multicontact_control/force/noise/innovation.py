"""R from the observers' innovations."""

from __future__ import annotations

from abc import abstractmethod

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.force.noise.base import Innovation, NoiseEstimator, usable
import numpy as np

BAYES_ITERATIONS = 3  # per sample


def corrected_square(innovation: Innovation, variance: Vector) -> Vector:
    """
    Return e^2 + C P C^T, what a correction with R, shape (r,) [N^2], leaves of an innovation.

    e = r R / (C P_1 C^T + R), and C P C^T = C P_1 C^T R / (C P_1 C^T + R); 0 for R = 0.
    """
    share = variance / np.where(
        variance > 0.0, innovation.prior_variance + variance, 1.0
    )
    square: Vector = (
        innovation.innovation * share
    ) ** 2 + innovation.prior_variance * share
    return square


class InnovationEstimator(NoiseEstimator):
    """An estimator that works on the observers' innovations alone."""

    uses_innovation = True

    def _take(self, innovation: Innovation | None) -> bool:
        if not usable(self._alpha):
            return False
        if innovation is None:
            return True
        if not all(
            usable(values)
            for values in (
                innovation.innovation,
                innovation.prior_variance,
                innovation.variance_used,
            )
        ):
            return False
        estimate, known = self._estimate_from(innovation)
        self._variance[:] = np.where(
            known, self.config.variance_scale * estimate, self._variance
        )
        return True

    @property
    def _kept(self) -> float:
        """Return the share of the past that a recursive estimate keeps, 1 - 1/N."""
        return 1.0 - 1.0 / self.config.window

    @abstractmethod
    def _estimate_from(self, innovation: Innovation) -> tuple[Vector, Mask]:
        """Return estimated variances, shape (r,) [N^2], and which of them are known."""


class InnovationWindow(InnovationEstimator):
    """
    Maybeck's maximum likelihood estimate (P04 ref. 6), R = (1/N) sum [r r^T - C P_1 C^T].

    Known after N innovations of a contact; noise can drive it below zero, whence the floor.
    """

    def _forget(self) -> None:
        self._samples: Matrix = np.zeros((self.config.window, self._contacts))
        self._counts = np.zeros(self._contacts, dtype=int)

    def _estimate_from(self, innovation: Innovation) -> tuple[Vector, Mask]:
        length, valid = len(self._samples), innovation.valid
        terms = innovation.innovation**2 - innovation.prior_variance
        contacts = np.flatnonzero(valid)
        self._samples[self._counts[contacts] % length, contacts] = terms[contacts]
        self._counts[contacts] += 1
        # Summed each time: a running sum would keep the rounding of every large sample for ever.
        return self._samples.sum(axis=0) / length, (self._counts >= length) & valid


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
        for _ in range(BAYES_ITERATIONS):
            scale = prior + 0.5 * corrected_square(innovation, scale / shape)
        # Without the bound one wild sample would be remembered for thousands of ticks.
        scale = np.minimum(scale, shape * self._largest / self.config.variance_scale)
        self._shape = shape
        self._scale = np.where(valid, scale, self._scale)
        return self._scale / self._shape, valid
