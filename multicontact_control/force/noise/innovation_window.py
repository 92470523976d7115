"""R from the innovations over a window: Maybeck's maximum likelihood estimate (P04 ref. 6)."""

from __future__ import annotations

from multicontact_control.arrays import Mask, Vector
from multicontact_control.force.noise.estimator import InnovationEstimator
from multicontact_control.force.noise.innovation import Innovation
from multicontact_control.force.noise.windows import WindowedMean


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
