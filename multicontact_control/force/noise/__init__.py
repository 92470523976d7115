"""Estimating the variance R_k of the force noise on-line (P04 sec. 4.2), in several ways."""

from typing import Any

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.errors import ConfigError
from multicontact_control.force.noise.base import Innovation, NoiseEstimator
from multicontact_control.registry import import_registered, NOISE_ESTIMATORS

__all__ = [
    'find_noise_estimator',
    'Innovation',
    'make_noise_estimator',
    'NoiseEstimator',
]


def find_noise_estimator(name: str) -> type[NoiseEstimator]:
    """
    Return the class of a registered noise estimator; its file is imported when first needed.

    ConfigError if one of another package cannot be imported, or is no `NoiseEstimator`.
    """
    title = f'noise estimator {name}'
    place = NOISE_ESTIMATORS[name]
    estimator: Any = import_registered(title, place)
    if not isinstance(estimator, type) or not issubclass(estimator, NoiseEstimator):
        raise ConfigError(title, f'a NoiseEstimator at {place}', repr(estimator))
    return estimator


def make_noise_estimator(config: NoiseEstimatorConfig) -> NoiseEstimator:
    """Return the estimator that a configuration names, before its first sample."""
    return find_noise_estimator(config.estimator)(config)
