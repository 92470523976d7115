"""Estimating the variance R_k of the force noise on-line (P04 sec. 4.2), in seven ways."""

from multicontact_control.force.noise.estimator import NoiseEstimator
from multicontact_control.force.noise.factory import ESTIMATORS, make_noise_estimator
from multicontact_control.force.noise.innovation import Innovation
from multicontact_control.force.noise.lead_filter import lead_filter, LeadFilter
from multicontact_control.force.noise.windows import WindowedMean, WindowedVariance

__all__ = [
    'ESTIMATORS', 'Innovation', 'LeadFilter', 'NoiseEstimator', 'WindowedMean',
    'WindowedVariance', 'lead_filter', 'make_noise_estimator']
