"""What an observer's prediction and the measurement make of each other."""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import Mask, Vector
import numpy as np


@dataclass(frozen=True, slots=True)
class Innovation:
    """
    The innovations of one tick, one per contact.

    A contact that is not force controlled, or whose observer has just been started, has no
    innovation. It is marked by a `variance_used` of 0, which no observer ever uses; its other
    entries mean nothing and are 0.

    Attributes
    ----------
    innovation
        r = alpha - C x_1, shape (r,) [N].
    prior_variance
        C P_1 C^T, the variance of r that the prediction accounts for, shape (r,) [N^2].
    variance_used
        R the observer worked with, shape (r,) [N^2].

    """

    innovation: Vector
    prior_variance: Vector
    variance_used: Vector

    @property
    def valid(self) -> Mask:
        """Which contacts have an innovation, shape (r,)."""
        mask: Mask = self.variance_used > 0.0
        return mask

    @property
    def residual(self) -> Vector:
        """Return what the correction leaves of r, e = r R / (C P_1 C^T + R), shape (r,) [N]."""
        return self.innovation * self._share_of_noise()

    @property
    def posterior_variance(self) -> Vector:
        """C P C^T = C P_1 C^T R / (C P_1 C^T + R), shape (r,) [N^2]."""
        return self.prior_variance * self._share_of_noise()

    def _share_of_noise(self) -> Vector:
        """Return R / (C P_1 C^T + R), 0 where there is no innovation, shape (r,)."""
        valid = self.valid
        share: Vector = (np.where(valid, self.variance_used, 0.0)
                         / np.where(valid, self.prior_variance + self.variance_used, 1.0))
        return share
