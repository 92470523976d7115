"""Estimating the variance R_k of the force noise on-line (P04 sec. 4.2), in several ways."""

from pkgutil import resolve_name

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.force.noise.base import Innovation, NoiseEstimator
from multicontact_control.registry import NOISE_ESTIMATORS

__all__ = ['Innovation', 'NoiseEstimator', 'make_noise_estimator']


def make_noise_estimator(config: NoiseEstimatorConfig) -> NoiseEstimator:
    """
    Return the estimator that a configuration names, before its first sample.

    Its file is one line in `registry.NOISE_ESTIMATORS`, and is imported when first needed.
    """
    estimator: type[NoiseEstimator] = resolve_name(NOISE_ESTIMATORS[config.estimator])
    return estimator(config)
