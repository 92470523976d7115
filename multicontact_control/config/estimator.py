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
        'lead_window', 'Estimate of R_k: windowed variance of the force behind a lead filter of '
        'unit gain at DC (eqs 42-44) or at high frequency, or without a filter; a fixed one; or '
        'from the innovations of the observers.')
    contact_names: tuple[str, ...] = parameter(
        ..., 'Contacts in the order of every contact vector.', min_length=1)
    rate: Real = parameter(500.0, 'Rate of the force samples.', unit='Hz', gt=0.0)
    window: int = parameter(
        50, 'Samples in the window N of eq. 43, of forces or of innovations; `sage_husa` and '
        '`variational_bayes` forget by 1 - 1/N.', ge=2, le=10000)
    zero_frequency: Real = parameter(3.0, 'Zero of G_f, eq. 42.', unit='Hz', gt=0.0)
    pole_frequency: Real = parameter(60.0, 'Pole of G_f, eq. 42.', unit='Hz', gt=0.0)
    variance_scale: Real = parameter(
        1.0, 'Factor of an estimated R, e.g. to compare estimators of equal R at rest.', gt=0.0)
    slew_time: Real = parameter(
        0.0, 'Time in which R changes by a factor e at most; 0 for no bound, as in the paper. A '
        'force step raises R, which with K_2 = 20 1/s slows the step: 0.03 s prevents that.',
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
