"""R as configured, whatever the samples: the baseline the paper calls unstable in motion."""

from __future__ import annotations

import numpy as np

from multicontact_control.arrays import Mask, Vector
from multicontact_control.force.noise.estimator import NoiseEstimator
from multicontact_control.force.noise.innovation import Innovation


class Fixed(NoiseEstimator):
    """The configured `fixed_variance`, which `variance_scale` does not scale."""

    def _forget(self) -> None:
        pass  # there is nothing to forget

    def _estimate(self, alpha: Vector, innovation: Innovation | None) -> tuple[Vector, Mask]:
        return self._variance, np.zeros(self._contacts, dtype=bool)
