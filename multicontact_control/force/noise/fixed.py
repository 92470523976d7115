"""The estimator `fixed`: a constant R."""

from __future__ import annotations

from multicontact_control.force.noise.base import Innovation, NoiseEstimator, usable


class Fixed(NoiseEstimator):
    """The configured `fixed_variance`, which `variance_scale` does not scale."""

    def _forget(self) -> None:
        pass

    def _take(self, innovation: Innovation | None) -> bool:
        return usable(self._alpha)
