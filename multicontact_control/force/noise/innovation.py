"""R from the observers' innovations."""

from __future__ import annotations

from abc import abstractmethod

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.force.noise.base import Innovation, NoiseEstimator, usable
import numpy as np


def corrected_square(innovation: Innovation, variance: Vector) -> Vector:
    """
    Return e^2 + C P C^T, what a correction with R, shape (r,) [N^2], leaves of an innovation.

    e = r R / (C P_1 C^T + R), and C P C^T = C P_1 C^T R / (C P_1 C^T + R); 0 for R = 0.
    """
    share = variance / np.where(
        variance > 0.0, innovation.prior_variance + variance, 1.0
    )
    corrected = innovation.innovation * share
    square: Vector = corrected**2 + innovation.prior_variance * share
    return square


class InnovationEstimator(NoiseEstimator):
    """An estimator that works on the observers' innovations alone."""

    uses_innovation = True

    def _take(self, innovation: Innovation | None) -> bool:
        if not usable(self._alpha):
            return False
        if innovation is None:
            return True
        if not (
            usable(innovation.innovation)
            and usable(innovation.prior_variance)
            and usable(innovation.variance_used)
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
        length = len(self._samples)
        valid = innovation.valid
        terms = innovation.innovation**2 - innovation.prior_variance
        contacts = np.flatnonzero(valid)
        self._samples[self._counts[contacts] % length, contacts] = terms[contacts]
        self._counts[contacts] += 1
        # Summed each time: a running sum would keep the rounding of every large sample for ever.
        return self._samples.sum(axis=0) / length, (self._counts >= length) & valid
