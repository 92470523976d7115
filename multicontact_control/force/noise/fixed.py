"""R as configured, whatever the samples: the baseline the paper calls unstable in motion."""

from __future__ import annotations

from multicontact_control.force.noise.estimator import MAX_MAGNITUDE, NoiseEstimator
from multicontact_control.force.noise.innovation import Innovation
from multicontact_control.force.noise.kernels import all_below


class Fixed(NoiseEstimator):
    """The configured `fixed_variance`, which `variance_scale` does not scale."""

    def _forget(self) -> None:
        pass  # there is nothing to forget

    def _take(self, innovation: Innovation | None) -> bool:
        return all_below(self._alpha, MAX_MAGNITUDE)
