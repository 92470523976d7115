"""Estimating the variance R_k of the force noise on-line (P04 sec. 4.2), in seven ways."""

from collections.abc import Mapping

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.force.noise.base import Fixed, Innovation, NoiseEstimator
from multicontact_control.force.noise.innovation import (
    InnovationWindow,
    SageHusa,
    VariationalBayes,
)
from multicontact_control.force.noise.window import (
    HfWindow,
    lead_filter,
    LeadWindow,
    Window,
)

__all__ = [
    'ESTIMATORS',
    'Innovation',
    'NoiseEstimator',
    'lead_filter',
    'make_noise_estimator',
]

ESTIMATORS: Mapping[str, type[NoiseEstimator]] = {
    'lead_window': LeadWindow,
    'hf_window': HfWindow,
    'window': Window,
    'fixed': Fixed,
    'innovation': InnovationWindow,
    'sage_husa': SageHusa,
    'variational_bayes': VariationalBayes,
}


def make_noise_estimator(config: NoiseEstimatorConfig) -> NoiseEstimator:
    """Return the estimator a configuration names, in its initial state."""
    return ESTIMATORS[config.estimator](config)
