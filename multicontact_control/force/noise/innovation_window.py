"""R from the innovations over a window: Maybeck's maximum likelihood estimate (P04 ref. 6)."""

from __future__ import annotations

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.force.noise.estimator import InnovationEstimator
from multicontact_control.force.noise.innovation import Innovation
import numpy as np


class InnovationWindow(InnovationEstimator):
    """
    The mean over the window of what the innovations show beyond the prediction's own share.

    prior form: R = (1/N) sum [r r^T - C P_1 C^T], which noise can drive below zero, whence the
    floor; posterior form: R = (1/N) sum [e e^T + C P C^T], which cannot be negative but holds
    on to the R it was computed with. A contact's R is known once it has had N innovations.
    """

    def _forget(self) -> None:
        self._window = WindowedMean(self.config.window, self._contacts)

    def _estimate_from(self, innovation: Innovation) -> tuple[Vector, Mask]:
        if self.config.innovation_form == 'prior':
            terms = innovation.innovation ** 2 - innovation.prior_variance
        else:
            terms = innovation.residual ** 2 + innovation.posterior_variance
        mean = self._window.update(terms, innovation.valid)
        return mean, self._window.full & innovation.valid


class WindowedMean:
    """
    Mean over the last N samples of each of r contacts, which may miss samples.

    Recomputed from the samples each time: a running sum would keep the rounding of every large
    sample for ever.
    """

    def __init__(self, window: int, contacts: int) -> None:
        self._samples: Matrix = np.zeros((window, contacts))
        self._counts = np.zeros(contacts, dtype=int)

    @property
    def full(self) -> Mask:
        """Which contacts have had N samples, shape (r,)."""
        mask: Mask = self._counts >= self._samples.shape[0]
        return mask

    def update(self, samples: Vector, valid: Mask) -> Vector:
        """
        Take in one sample, shape (r,), of every contact that is `valid`.

        Returns
        -------
        Vector
            Mean of each contact's window as if empty places held 0, shape (r,).

        """
        contacts = np.flatnonzero(valid)
        rows = self._counts[contacts] % self._samples.shape[0]
        self._samples[rows, contacts] = samples[contacts]
        self._counts[contacts] += 1
        mean: Vector = self._samples.sum(axis=0) / self._samples.shape[0]
        return mean
