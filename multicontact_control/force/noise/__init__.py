"""Estimating the variance R_k of the force noise on-line (P04 sec. 4.2), in seven ways."""

from collections.abc import Mapping

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.force.noise.estimator import NoiseEstimator
from multicontact_control.force.noise.filtered_window import HfWindow, LeadWindow, Window
from multicontact_control.force.noise.fixed import Fixed
from multicontact_control.force.noise.innovation import Innovation
from multicontact_control.force.noise.innovation_window import InnovationWindow, WindowedMean
from multicontact_control.force.noise.lead_filter import lead_filter, LeadFilter
from multicontact_control.force.noise.sage_husa import SageHusa
from multicontact_control.force.noise.variational_bayes import VariationalBayes

__all__ = [
    'ESTIMATORS', 'Innovation', 'LeadFilter', 'NoiseEstimator', 'WindowedMean', 'lead_filter',
    'make_noise_estimator']

ESTIMATORS: Mapping[str, type[NoiseEstimator]] = {
    'lead_window': LeadWindow, 'hf_window': HfWindow, 'window': Window, 'fixed': Fixed,
    'innovation': InnovationWindow, 'sage_husa': SageHusa, 'variational_bayes': VariationalBayes}


def make_noise_estimator(config: NoiseEstimatorConfig) -> NoiseEstimator:
    """Return the estimator a configuration names, in its initial state."""
    return ESTIMATORS[config.estimator](config)
