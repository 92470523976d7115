"""The on-line estimate of the noise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from multicontact_control.config.base import Config, cross_check, parameter, Real
from multicontact_control.errors import ConfigError


class NoiseEstimatorConfig(Config):
    """The on-line estimate of R_k (P04 sec. 4.2)."""

    estimator: Literal[
        'lead_window', 'hf_window', 'window', 'fixed', 'innovation', 'sage_husa',
        'variational_bayes'] = parameter(
        'lead_window', 'How R_k is estimated: the windowed variance of the force behind a lead '
        'filter of unit gain at DC (eqs 42-44) or at high frequency, or without a filter; not '
        'at all; or from the innovations of the observers.')
    contact_names: tuple[str, ...] = parameter(
        ..., 'Contacts in the order of every contact vector.', min_length=1)
    rate: Real = parameter(500.0, 'Rate of the force samples.', unit='Hz', gt=0.0)
    window: int = parameter(
        50, 'Samples in the window N of eq. 43, of forces or of innovations.', ge=2, le=10000)
    zero_frequency: Real = parameter(3.0, 'Zero of G_f, eq. 42.', unit='Hz', gt=0.0)
    pole_frequency: Real = parameter(60.0, 'Pole of G_f, eq. 42.', unit='Hz', gt=0.0)
    forgetting_factor: Real = parameter(
        0.98, 'Forgetting factor b of `sage_husa`; 0.98 remembers about 50 samples.',
        gt=0.0, lt=1.0)
    bayes_decay: Real = parameter(
        0.98, 'Decay rho of `variational_bayes`; 0.98 remembers about 50 samples.',
        gt=0.0, lt=1.0)
    variance_scale: Real = parameter(
        1.0, 'What an estimated R is multiplied by, e.g. to compare two estimators at the same '
        'value at rest; `fixed_variance` is not.', gt=0.0)
    slew_time: Real = parameter(
        0.0, 'Time in which R may change by a factor e, either way; 0 for as it comes, as in the '
        'paper. A force step makes R jump, which with K_2 = 20 1/s slows the very step: with '
        '0.03 s it does not.',
        unit='s', ge=0.0, le=10.0)
    fixed_variance: Real = parameter(
        0.6, 'R of the estimator `fixed`, and of the others until they know one.',
        unit='N^2', gt=0.0)

    @cross_check
    def _check_across_fields(self) -> Iterator[ConfigError]:
        for name in ('zero_frequency', 'pole_frequency'):
            if getattr(self, name) >= 0.5 * self.rate:
                yield ConfigError(
                    name, f'below the Nyquist frequency {0.5 * self.rate:g} Hz',
                    f'{getattr(self, name):g} Hz')
