"""The force laws with their gains, the stiffness found on-line, and the estimate of the noise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from multicontact_control.choices import EstimatorName, LawName
from multicontact_control.config.base import Config, parameter
from multicontact_control.errors import ConfigError

FedForward = Literal['estimate', 'desired', 'mixed', 'measured']


class PiConfig(Config):
    """
    The law `pi`: u = K_p e + K_i int e dt of the force error e, with K_p = bandwidth K_2 / k.

    The stiffness k and the damping K_2 are those of the loop that it closes.
    """

    bandwidth: float = parameter(
        24.0,
        'Bandwidth of the loop with K_p alone.',
        unit='rad/s',
        live=True,
        gt=0.0,
        le=500.0,
    )
    integral_rate: float = parameter(
        5.0, 'K_i / K_p.', unit='1/s', live=True, gt=0.0, le=100.0
    )
    filter_cutoff: float = parameter(
        30.0,
        'Cut-off of a low-pass on the force, 0 for none.',
        unit='Hz',
        live=True,
        ge=0.0,
    )


class DobConfig(Config):
    """
    The law `dob`: a disturbance observer with a filter Q of second order.

    What the modelled plant does not explain of the force is taken off the input.
    """

    observer_bandwidth: float = parameter(
        40.0, 'Double pole of Q.', unit='rad/s', live=True, gt=0.0, le=1000.0
    )
    bandwidth: float = parameter(
        25.0,
        'Bandwidth of the force loop around it.',
        unit='rad/s',
        live=True,
        gt=0.0,
        le=500.0,
    )


class LqgConfig(Config):
    """
    The law `lqg`: a steady Kalman filter with a disturbance state, and an LQ regulator.

    It has the model of the active observer, but constant gains.
    """

    noise_variance: float = parameter(
        2.0, 'R of the steady filter.', unit='N^2', live=True, gt=0.0
    )
    input_weight: float = parameter(
        1.0,
        'Weight of an input of 1 m/s^2 against a force error of 1 N.',
        live=True,
        gt=0.0,
    )


class AdmittanceConfig(Config):
    """
    The law `admittance`: a virtual mass and damper turn force errors into speed.

    M dv/dt = e - D v; an integral of the error is added to v.
    """

    bandwidth: float = parameter(
        25.0, 'k over the virtual damping.', unit='rad/s', live=True, gt=0.0, le=500.0
    )
    inertia_time: float = parameter(
        0.005,
        'Virtual mass over the virtual damping.',
        unit='s',
        live=True,
        ge=1e-4,
        le=1.0,
    )
    integral_rate: float = parameter(
        5.0,
        'Decay rate of a constant force error.',
        unit='1/s',
        live=True,
        ge=0.0,
        le=100.0,
    )


class ImpedanceConfig(Config):
    """
    The law `impedance`: a virtual spring to a point that lies alpha_des / k in the surface.

    Nothing integrates a force error away: the force is as exact as the stiffness k of the model.
    """

    natural_frequency: float = parameter(
        30.0,
        'Natural frequency of that spring.',
        unit='rad/s',
        live=True,
        gt=0.0,
        le=500.0,
    )


class AdaptiveStiffnessConfig(Config):
    """
    The stiffness that the observers' model follows, with `force.stiffness: adaptive`.

    It begins at the highest at each touch, which is the safe side, and follows the estimate.
    """

    lowest: float = parameter(
        200.0, 'Smallest stiffness of the model.', unit='N/m', gt=0.0
    )
    highest: float = parameter(
        8e4, 'Largest stiffness of the model, at the first touch.', unit='N/m', gt=0.0
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        if self.highest <= self.lowest:
            yield ConfigError(
                'adaptive.highest',
                f'above adaptive.lowest, {self.lowest:g} N/m',
                self.highest,
            )


class ForceConfig(Config):
    """
    The force law and its active observer, one per contact (P04 sec. 3.2, 4).

    The loop has a dominant pole at 1 / time_constant; its observer estimates the force, its rate
    and an active state, with R from the noise estimator.
    """

    law: LawName = parameter(
        'aob', 'Force law: the active observer, or one to compare it with.', live=True
    )
    fed_forward: FedForward = parameter(
        'mixed',
        'Force fed forward in eq. 24: the estimate, as in the paper, the desired force, '
        'as much of that as acts before the loop does, or the measured force.',
        live=True,
    )
    stiffness: Literal['configured', 'adaptive'] = parameter(
        'configured', 'Stiffness of the model: contacts.*.stiffness, or found on-line.'
    )
    adaptive: AdaptiveStiffnessConfig = AdaptiveStiffnessConfig()
    pi: PiConfig = PiConfig()
    dob: DobConfig = DobConfig()
    lqg: LqgConfig = LqgConfig()
    admittance: AdmittanceConfig = AdmittanceConfig()
    impedance: ImpedanceConfig = ImpedanceConfig()
    time_constant: float = parameter(
        0.02,
        'Time constant of the dominant closed-loop pole.',
        unit='s',
        live=True,
        gt=0.0,
    )
    second_pole_ratio: float = parameter(
        1.0,
        'Second pole relative to the first, 1 for two equal ones.',
        live=True,
        ge=1.0,
    )
    damping_rate: float = parameter(
        100.0,
        'K_2 of eq. 32, damping of the contact motion.',
        unit='1/s',
        live=True,
        ge=0.0,
    )
    input_delay: float = parameter(
        0.006, 'T_d of eq. 32, from commanded to acting input.', unit='s', ge=0.0
    )
    process_noise: float = parameter(
        1e-3, 'Q_k = process_noise I (P04 sec. 5.2).', live=True, gt=0.0
    )
    active_state_order: int = parameter(
        1,
        'Order of the active state p_k, 0 for plain pole placement without it.',
        ge=0,
        le=3,
    )
    allocation: Literal['decoupled', 'paper'] = parameter(
        'decoupled',
        'Force allocation: f_c* = N (N^T N)^-1 alpha* or N alpha* (eq. 30).',
    )
    projection: Literal['euclidean', 'inertia'] = parameter(
        'euclidean',
        'Metric of Omega_f and Omega_m: eqs 11-12 or dynamically consistent.',
    )


class VarianceBoundsConfig(Config):
    """
    What every noise variance R lies between, in the estimator and in the observers.

    Both clip it. A bound that is reached is a remark in the run's summary, with the share of the
    samples.
    """

    smallest: float = parameter(
        0.1,
        'Smallest R; with less the observer outruns the drives.',
        unit='N^2',
        gt=0.0,
    )
    largest: float = parameter(
        1000.0,
        'Largest R; with more the law is blind to the force.',
        unit='N^2',
        gt=0.0,
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        if self.largest <= self.smallest:
            yield ConfigError(
                'noise_variance.largest',
                f'above noise_variance.smallest, {self.smallest:g} N^2',
                self.largest,
            )


class NoiseEstimatorConfig(Config):
    """
    The on-line estimate of the variance R_k of each force (P04 sec. 4.2).

    It has a node of its own; contacts, rate and bounds are those of the controller.
    """

    estimator: EstimatorName = parameter(
        'lead_window',
        'Estimate of R_k: variance in a window, of the force behind a lead filter '
        '(eqs 42-44; hf: of unit gain at high frequency) or as it is; fixed; or of innovations.',
    )
    contact_names: tuple[str, ...] = parameter(
        ..., 'Contacts in the order of every contact vector.', min_length=1
    )
    rate: float = parameter(500.0, 'Rate of the force samples.', unit='Hz', gt=0.0)
    window: int = parameter(
        50,
        'Samples N in the window of eq. 43; others forget by 1 - 1/N.',
        ge=2,
        le=10000,
    )
    zero_frequency: float = parameter(3.0, 'Zero of G_f, eq. 42.', unit='Hz', gt=0.0)
    pole_frequency: float = parameter(60.0, 'Pole of G_f, eq. 42.', unit='Hz', gt=0.0)
    variance_scale: float = parameter(
        1.0,
        'Factor of an estimated R, e.g. to compare estimators of equal R at rest.',
        gt=0.0,
    )
    slew_time: float = parameter(
        0.0,
        'Time in which R changes by a factor e at most, so that a force step raises it less; '
        '0 for no bound, as in the paper.',
        unit='s',
        ge=0.0,
        le=10.0,
    )
    fixed_variance: float = parameter(
        0.6, 'R of the estimator `fixed`, and of others at first.', unit='N^2', gt=0.0
    )
    noise_variance: VarianceBoundsConfig = VarianceBoundsConfig()

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        for name in ('zero_frequency', 'pole_frequency'):
            if getattr(self, name) >= 0.5 * self.rate:
                yield ConfigError(
                    name,
                    f'below {0.5 * self.rate:g} Hz, half the rate',
                    getattr(self, name),
                )
