"""
The configuration of the controller and the estimator: every tunable value, once.

Each field carries its default, unit, description and range here and nowhere else. The ROS
parameters of the nodes are generated from these models, the YAML files in ``config/`` are ROS 2
parameter files that these models validate, and both report a bad value in the same one line.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from pathlib import Path
from typing import Annotated, Any, get_args, Literal, TypeVar

from multicontact_control.errors import ConfigError
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator, ValidationError
import yaml

UNIT_NORM_TOLERANCE = 1e-3
MAX_DELAY_PERIODS = 10
WRENCH_SIZE = 6

ModelT = TypeVar('ModelT', bound='Config')


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError('expected a finite number')
    return value


def _unit_length(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    norm = math.sqrt(sum(x * x for x in vector))
    if not abs(norm - 1.0) <= UNIT_NORM_TOLERANCE:
        raise ValueError(
            f'expected a vector of unit length (within {UNIT_NORM_TOLERANCE}), length {norm:.6g}')
    x, y, z = (component / norm for component in vector)
    return (x, y, z)


Real = Annotated[float, AfterValidator(_finite)]
Vector = tuple[Real, ...]
Vector3 = tuple[Real, Real, Real]
UnitVector3 = Annotated[Vector3, AfterValidator(_unit_length)]


def parameter(
    default: Any, description: str, *, unit: str = '', live: bool = False, **bounds: Any,
) -> Any:
    """
    Declare one tunable value.

    Parameters
    ----------
    default
        Default value; ``...`` makes the value required.
    description
        One sentence; the unit is appended to it in the ROS parameter description.
    unit
        SI unit, empty for names and flags.
    live
        Whether the value may be changed while a node runs.
    bounds
        Pydantic bounds: ``gt``, ``ge``, ``lt``, ``le``, ``min_length``.

    Returns
    -------
    Any
        A pydantic field.

    """
    return Field(
        default, description=description, json_schema_extra={'unit': unit, 'live': live}, **bounds)


class Config(BaseModel):
    """Base of every configuration: frozen, and strict about unknown keys."""

    model_config = ConfigDict(extra='forbid', frozen=True, validate_default=True)


class RobotConfig(Config):
    """Where the robot's model comes from and what its joints and frames are called."""

    urdf: str = parameter(
        ..., 'URDF of the arm with its tool: a path, or a path relative to the parameter file.')
    joint_names: tuple[str, ...] = parameter(
        ..., 'Joints in the order of every joint vector.', min_length=1)
    armature: Vector = parameter(
        (), 'Rotor inertia seen at each joint; empty for none.', unit='kg m^2')
    operational_frame: str = parameter(
        ..., 'URDF link that carries the operational point and its axes.')
    sensor_frame: str = parameter(
        ..., 'URDF link in whose axes and at whose origin the wrist sensor reads.')
    gravity_world: Vector3 = parameter((0.0, 0.0, -9.81), 'Gravity.', unit='m/s^2')


class ToolConfig(Config):
    """What hangs on the sensor and is weighed by it, for subtraction from its readings."""

    mass: Real = parameter(0.0, 'Mass beyond the sensor.', unit='kg', ge=0.0)
    com_sensor: Vector3 = parameter(
        (0.0, 0.0, 0.0), 'Centre of mass of that, in the sensor frame.', unit='m')
    bias_sensor: Vector = parameter(
        (0.0,) * 6, 'Reading of the sensor under no load, force first, subtracted from every one.',
        unit='N, N m')

    @model_validator(mode='after')
    def _check_length(self) -> ToolConfig:
        if len(self.bias_sensor) != WRENCH_SIZE:
            raise ConfigError('tool.bias_sensor', '6 values', len(self.bias_sensor))
        return self


class SensorFrontEndConfig(Config):
    """What is done to the wrist sensor's readings before anything else sees them."""

    filter_order: int = parameter(
        0, 'Order of the low-pass on the readings: 0 for none, 1, or 2 (Butterworth).', ge=0, le=2)
    filter_cutoff: Real = parameter(
        125.0, 'Cut-off of that low-pass; its delay is added to force.input_delay.', unit='Hz',
        gt=0.0)
    full_scale: Vector = parameter(
        (), 'Largest reading of each axis, force first; empty where it is not known, and then '
        'saturation is not detected.', unit='N, N m')
    saturation_fraction: Real = parameter(
        0.99, 'Share of full scale from which a reading counts as saturated.', gt=0.0, le=1.0)
    frozen_ticks: int = parameter(
        0, 'Identical readings in a row that mean a frozen sensor; 0 to not look for one.', ge=0)
    require_push_test: bool = parameter(
        False, 'Whether force control stays disabled until a push test has proved sign, frame '
        'and scale of the sensor.')

    @model_validator(mode='after')
    def _check(self) -> SensorFrontEndConfig:
        if self.full_scale and len(self.full_scale) != WRENCH_SIZE:
            raise ConfigError('sensor.full_scale', '6 values or none', len(self.full_scale))
        if min(self.full_scale, default=1.0) <= 0.0:
            raise ConfigError('sensor.full_scale', 'values above 0', min(self.full_scale))
        if self.frozen_ticks == 1:
            raise ConfigError('sensor.frozen_ticks', '0 or at least 2', 1)
        return self

    def filter_delay(self, rate: float) -> float:
        """
        Return by how much the low-pass delays what changes slowly.

        Its group delay at 0 Hz, exact for the bilinear transform: with K = tan(pi f_c / f_s),
        1 / (2 K) samples for order 1 and 1 / (sqrt(2) K) for order 2.

        Parameters
        ----------
        rate
            Rate of the readings [Hz].

        Returns
        -------
        float
            The delay [s], 0 without a low-pass.

        """
        if self.filter_order == 0:
            return 0.0
        samples = 1.0 / math.tan(math.pi * self.filter_cutoff / rate)
        return samples / ((2.0 if self.filter_order == 1 else math.sqrt(2.0)) * rate)


class MotionConfig(Config):
    """The PD motion law (P04 sec. 3.1, 5.2)."""

    natural_frequency: Real = parameter(
        30.0, 'Natural frequency of the motion loop.', unit='rad/s', live=True, gt=0.0, le=200.0)
    damping_ratio: Real = parameter(
        1.0, 'Damping ratio of the motion loop.', live=True, gt=0.0, le=5.0)


class ForceConfig(Config):
    """The force law and its active observer, one per contact (P04 sec. 3.2, 4)."""

    time_constant: Real = parameter(
        0.02, 'Time constant of the dominant closed-loop pole.', unit='s', live=True, gt=0.0)
    second_pole_ratio: Real = parameter(
        1.0, 'Second pole relative to the first, 1 for two equal ones.', live=True, ge=1.0)
    damping_rate: Real = parameter(
        20.0, 'K_2 of eq. 32, damping of the contact motion.', unit='1/s', live=True, ge=0.0)
    input_delay: Real = parameter(
        0.006, 'T_d of eq. 32, from commanded to acting input.', unit='s', ge=0.0)
    process_noise: Real = parameter(
        1e-3, 'Q_k = process_noise I (P04 sec. 5.2).', live=True, gt=0.0)
    initial_covariance: Real = parameter(1e-3, 'P_0 = initial_covariance I.', gt=0.0)
    active_state_order: int = parameter(
        1, 'Order of the active state p_k, 0 for plain pole placement without it.', ge=0, le=3)
    allocation: Literal['decoupled', 'paper'] = parameter(
        'decoupled', 'Force allocation: f_c* = N (N^T N)^-1 alpha* or N alpha* (eq. 30).')
    projection: Literal['euclidean', 'inertia'] = parameter(
        'euclidean', 'Metric of Omega_f and Omega_m: eqs 11-12 or dynamically consistent.')


class FrictionConfig(Config):
    """Compensation of the joints' friction, which the paper's model does not have."""

    coulomb: Vector = parameter(
        (), 'Coulomb friction added per joint in the direction of its motion; empty for none.',
        unit='N m')
    viscous: Vector = parameter(
        (), 'Viscous friction added per joint; empty for none.', unit='N m s/rad')
    speed: Real = parameter(
        0.02, 'Joint speed at which tanh(v / speed) lets most of the Coulomb friction in.',
        unit='rad/s', live=True, gt=0.0)


class ContactConfig(Config):
    """One point contact."""

    normal_world: UnitVector3 = parameter(
        ..., 'Unit surface normal INTO the surface, in world axes.')
    point_operational: Vector3 = parameter(
        ..., 'Contact point in the operational frame.', unit='m')
    stiffness: Real = parameter(
        6000.0, 'Modelled stiffness k_env at the contact point.', unit='N/m', gt=0.0)


class ContactStateConfig(Config):
    """When a contact counts as made, held or lost, and how it is looked for."""

    approach_speed: Real = parameter(
        0.02, 'Largest speed along a normal towards a surface that is not felt; what a scenario '
        'says of its approach goes before.', unit='m/s', gt=0.0, le=0.25)
    approach_ramp_time: Real = parameter(
        0.5, 'Time to reach that speed.', unit='s', gt=0.0, le=10.0)
    approach_distance: Real = parameter(
        0.1, 'A surface not met over this distance is given up.', unit='m', gt=0.0, le=2.0)
    search_distance: Real = parameter(
        0.01, 'A lost surface not met this far beyond where it was is given up.', unit='m',
        gt=0.0, le=0.5)
    contact_threshold: Real = parameter(
        1.5, 'Measured force that counts as touch.', unit='N', gt=0.0, le=100.0)
    release_threshold: Real = parameter(
        0.5, 'Measured force below which a contact may be lost.', unit='N', ge=0.0, le=100.0)
    release_fraction: Real = parameter(
        0.3, 'The same relative to the force it was held with or is to have, whichever is less: '
        'a tool that falls after its surface reads its own inertia.', ge=0.0, lt=1.0)
    escape_speed: Real = parameter(
        0.1, 'Speed of the contact point into its surface that only a lost one reaches.',
        unit='m/s', gt=0.0, le=5.0)
    preload: Real = parameter(
        2.0, 'Desired force from touch until the contact holds.', unit='N', gt=0.0, le=100.0)
    force_rate: Real = parameter(
        100.0, 'Rise of the desired force of a contact that was lost, from touch on.',
        unit='N/s', gt=0.0, le=1e4)
    impact_time: Real = parameter(
        0.05, 'Least time in contact from touch to holding.', unit='s', ge=0.0, le=1.0)
    loss_time: Real = parameter(
        0.004, 'Time below the release threshold until a contact is lost.', unit='s', ge=0.0,
        le=1.0)
    lost_time: Real = parameter(
        0.05, 'Least time from loss to a new approach.', unit='s', ge=0.0, le=10.0)
    braking: Real = parameter(
        5.0, 'Acceleration that brakes a tip that has lost its surface, or pulls it back.',
        unit='m/s^2', gt=0.0, le=50.0)
    force_ceiling: Real = parameter(
        60.0, 'Measured force at which a contact is left.', unit='N', gt=0.0, le=1000.0)
    retract_distance: Real = parameter(
        0.01, 'Way back from a surface that is left.', unit='m', gt=0.0, le=0.2)
    retract_speed: Real = parameter(
        0.05, 'Speed on that way.', unit='m/s', gt=0.0, le=0.25)
    blend_time: Real = parameter(
        0.003, 'Time constant by which a change of active contacts, or of the law, is blended.',
        unit='s', gt=0.0, le=1.0)
    energy_limit: Real = parameter(
        0.5, 'Energy a contact may take up beyond what it stores, within energy_memory.',
        unit='J', gt=0.0, le=100.0)
    energy_memory: Real = parameter(
        1.0, 'Time constant by which that energy is forgotten.', unit='s', gt=0.0, le=100.0)
    injected_damping: Real = parameter(
        0.0, 'Force per speed taken from the command while that limit is passed; 0 for none.',
        unit='N s/m', ge=0.0, le=1e4)

    @model_validator(mode='after')
    def _check_across_fields(self) -> ContactStateConfig:
        if not self.release_threshold < self.contact_threshold < self.force_ceiling:
            raise ConfigError(
                'contact_state.contact_threshold',
                f'above release_threshold {self.release_threshold:g} N and below force_ceiling '
                f'{self.force_ceiling:g} N', f'{self.contact_threshold:g} N')
        return self


class LimitsConfig(Config):
    """What no command and no motion may exceed; an empty list is no limit."""

    joint_lower: Vector = parameter((), 'Lower stop of each joint.', unit='rad')
    joint_upper: Vector = parameter((), 'Upper stop of each joint.', unit='rad')
    joint_margin: Real = parameter(
        0.02, 'How far before its stop a joint is to stand still.', unit='rad', ge=0.0, le=1.0)
    joint_speed: Vector = parameter((), 'Largest speed of each joint.', unit='rad/s')
    joint_braking: Real = parameter(
        5.0, 'Deceleration counted on before a stop.', unit='rad/s^2', gt=0.0, le=500.0)
    torque_rate: Vector = parameter((), 'Largest rate of each torque.', unit='N m/s')
    operational_speed: Real = parameter(
        0.5, 'Largest speed of the operational point.', unit='m/s', gt=0.0, le=10.0)
    operational_turn: Real = parameter(
        2.0, 'Largest angular speed of the operational frame.', unit='rad/s', gt=0.0, le=50.0)
    workspace_lower: Vector = parameter(
        (), 'Lower corner of the box the operational point stays in.', unit='m')
    workspace_upper: Vector = parameter((), 'Upper corner of that box.', unit='m')
    singular_mobility: Real = parameter(
        0.004, 'Smallest eigenvalue of J M^-1 J^T up to which Lambda is damped, 0 for never.',
        unit='1/kg', ge=0.0, le=1.0)

    @model_validator(mode='after')
    def _check_across_fields(self) -> LimitsConfig:
        for kind in ('joint', 'workspace'):
            lower, upper = getattr(self, f'{kind}_lower'), getattr(self, f'{kind}_upper')
            if len(lower) != len(upper) or any(a >= b for a, b in zip(lower, upper)):
                raise ConfigError(
                    f'limits.{kind}_lower', f'one value below each of {kind}_upper', list(lower))
        if len(self.workspace_lower) not in (0, 3):
            raise ConfigError('limits.workspace_lower', '3 values', len(self.workspace_lower))
        for name in ('joint_speed', 'torque_rate'):
            if min(getattr(self, name), default=1.0) <= 0.0:
                raise ConfigError(f'limits.{name}', 'values above 0', min(getattr(self, name)))
        return self


Reaction = Literal['hold', 'float', 'damp']


class WatchdogConfig(Config):
    """When an input is no longer believed, and what happens then."""

    joint_max_age: Real = parameter(
        0.003, 'Largest age of a joint state.', unit='s', gt=0.0, le=1.0)
    wrench_max_age: Real = parameter(0.003, 'Largest age of a wrench.', unit='s', gt=0.0, le=1.0)
    variance_max_age: Real = parameter(
        0.005, 'Largest age of R, which is one period old when all is well.', unit='s', gt=0.0,
        le=10.0)
    variance_growth: Real = parameter(
        1.1, 'Factor per period on an R that is not renewed.', ge=1.0, le=10.0)
    variance_floor: Real = parameter(
        0.1, 'Smallest R that is used: a smaller one makes the observer faster than the drives.',
        unit='N^2', gt=0.0)
    variance_ceiling: Real = parameter(
        1e3, 'Where that growth ends, and the largest R that is believed.', unit='N^2', gt=0.0)
    on_joint_fault: Reaction = parameter(
        'float', 'Reaction to a joint state that is missing, stale or not believed.')
    on_wrench_fault: Reaction = parameter(
        'hold', 'Reaction to a wrench that is missing, stale or not believed.')
    on_clock_fault: Reaction = parameter(
        'hold', 'Reaction to time that runs backwards or at a wrong rate.')
    on_motion_fault: Reaction = parameter(
        'hold', 'Reaction to a speed beyond its limit.')
    on_law_fault: Reaction = parameter(
        'damp', 'Reaction to a control law that raises or gives no finite torque.')
    rate_band: Real = parameter(
        2.5, 'Twice in a row a period beyond 1 / rate_band to rate_band times the right one is '
        'a fault.', gt=1.0, le=100.0)
    frozen_samples: int = parameter(
        2, 'Repetitions, bit by bit, that make a reading frozen; 0 for a sensor without noise.',
        ge=0, le=1000)
    wrench_full_scale: Vector = parameter(
        (), 'Reading of each axis at which the sensor saturates; empty if unknown.',
        unit='N, N m')
    pull_threshold: Real = parameter(
        4.0, 'Measured pull of a surface that makes the wrench unbelievable.', unit='N', gt=0.0)
    friction_bound: Real = parameter(
        0.8, 'Largest believable ratio of sideways to normal forces.', gt=0.0, le=10.0)
    friction_offset: Real = parameter(
        5.0, 'Sideways force that is always believed.', unit='N', gt=0.0)
    position_jump: Real = parameter(
        0.01, 'Largest believable difference between a joint angle and the one its speeds lead '
        'to.', unit='rad', gt=0.0)
    hold_frequency: Real = parameter(
        10.0, 'Natural frequency of the joints while the posture is held.', unit='rad/s',
        gt=0.0, le=100.0)
    damping_rate: Real = parameter(
        5.0, 'Damping of the joints over their inertia, of the reaction `damp`.', unit='1/s',
        gt=0.0, le=100.0)
    recovery_time: Real = parameter(
        0.05, 'How long all inputs must be good before control resumes.', unit='s', ge=0.0,
        le=60.0)

    @model_validator(mode='after')
    def _check_lengths(self) -> WatchdogConfig:
        if len(self.wrench_full_scale) not in (0, 6):
            raise ConfigError(
                'watchdog.wrench_full_scale', '6 values', len(self.wrench_full_scale))
        return self


class ControllerConfig(Config):
    """Everything the controller needs to know."""

    rate: Real = parameter(500.0, 'Control rate 1/h.', unit='Hz', gt=0.0)
    robot: RobotConfig
    tool: ToolConfig = ToolConfig()
    sensor: SensorFrontEndConfig = SensorFrontEndConfig()
    motion: MotionConfig = MotionConfig()
    force: ForceConfig = ForceConfig()
    friction: FrictionConfig = FrictionConfig()
    contact_names: tuple[str, ...] = parameter(
        ..., 'Contacts in the order of every contact vector.', min_length=1)
    contacts: dict[str, ContactConfig]
    contact_state: ContactStateConfig = ContactStateConfig()
    limits: LimitsConfig = LimitsConfig()
    watchdog: WatchdogConfig = WatchdogConfig()
    wrench_input: Literal['raw', 'filtered'] = parameter(
        'raw', 'Which wrench feeds the loop: ft_sensor/wrench or ft_sensor/wrench_filtered.')
    initial_noise_variance: Real = parameter(
        0.6, 'R until an estimate arrives.', unit='N^2', gt=0.0)
    torque_limit: Vector = parameter(
        (), 'Largest commanded torque per joint; empty for none.', unit='N m')
    nullspace_damping: Real = parameter(
        2.0, 'Joint damping in the null space of arms with more than six joints.',
        unit='1/s', ge=0.0)

    @model_validator(mode='after')
    def _check_across_fields(self) -> ControllerConfig:
        joints = len(self.robot.joint_names)
        per_joint = {
            'robot.armature': self.robot.armature, 'friction.coulomb': self.friction.coulomb,
            'friction.viscous': self.friction.viscous, 'torque_limit': self.torque_limit,
            'limits.joint_lower': self.limits.joint_lower,
            'limits.joint_speed': self.limits.joint_speed,
            'limits.torque_rate': self.limits.torque_rate}
        for name, values in per_joint.items():
            if values and len(values) != joints:
                raise ConfigError(name, f'{joints} values, one per joint', f'{len(values)}')
        for name in self.contact_names:
            if name not in self.contacts:
                raise ConfigError(
                    'contact_names', f'names among {", ".join(sorted(self.contacts))}',
                    f"'{name}'")
        if len(set(self.contact_names)) != len(self.contact_names):
            raise ConfigError('contact_names', 'distinct names', list(self.contact_names))
        self._check_delay()
        return self

    def _check_delay(self) -> None:
        sensor, nyquist = self.sensor, 0.5 * self.rate
        if sensor.filter_order and sensor.filter_cutoff >= nyquist:
            raise ConfigError(
                'sensor.filter_cutoff', f'below the Nyquist frequency {nyquist:g} Hz',
                f'{sensor.filter_cutoff:g} Hz')
        if self.loop_delay * self.rate <= MAX_DELAY_PERIODS + 1e-9:
            return
        field, found = 'force.input_delay', f'{self.force.input_delay:g} s'
        if sensor.filter_order:
            field += ' and the delay of sensor.filter_cutoff'
            found += f' + {sensor.filter_delay(self.rate):.4g} s'
        raise ConfigError(
            field, f'at most {MAX_DELAY_PERIODS} periods ({MAX_DELAY_PERIODS / self.rate:g} s)',
            found)

    @property
    def loop_delay(self) -> float:
        """T_d of the force loop: force.input_delay and that of the sensor's low-pass [s]."""
        return self.force.input_delay + self.sensor.filter_delay(self.rate)

    @property
    def period(self) -> float:
        """Control period h [s]."""
        return 1.0 / self.rate


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
    innovation_form: Literal['prior', 'posterior'] = parameter(
        'prior', 'Form of `innovation`: mean of r r^T - C P_1 C^T or of e e^T + C P C^T.')
    forgetting_factor: Real = parameter(
        0.98, 'Forgetting factor b of `sage_husa`; 0.98 remembers about 50 samples.',
        gt=0.0, lt=1.0)
    bayes_decay: Real = parameter(
        0.98, 'Decay rho of `variational_bayes`; 0.98 remembers about 50 samples.',
        gt=0.0, lt=1.0)
    bayes_iterations: int = parameter(
        3, 'Iterations of `variational_bayes` per sample.', ge=1, le=20)
    variance_scale: Real = parameter(
        1.0, 'What an estimated R is multiplied by, e.g. to compare two estimators at the same '
        'value at rest; `fixed_variance` is not.', gt=0.0)
    fixed_variance: Real = parameter(
        0.6, 'R of the estimator `fixed`, and of the others until they know one.',
        unit='N^2', gt=0.0)
    variance_floor: Real = parameter(1e-3, 'Smallest R ever given out.', unit='N^2', gt=0.0)
    variance_ceiling: Real = parameter(1e6, 'Largest R ever given out.', unit='N^2', gt=0.0)

    @model_validator(mode='after')
    def _check_across_fields(self) -> NoiseEstimatorConfig:
        for name in ('zero_frequency', 'pole_frequency'):
            if getattr(self, name) >= 0.5 * self.rate:
                raise ConfigError(
                    name, f'below the Nyquist frequency {0.5 * self.rate:g} Hz',
                    f'{getattr(self, name):g} Hz')
        if not self.variance_floor < self.variance_ceiling:
            raise ConfigError(
                'variance_floor', f'below variance_ceiling {self.variance_ceiling:g}',
                f'{self.variance_floor:g}')
        return self


def validate(model: type[ModelT], values: Mapping[str, Any], source: str = '') -> ModelT:
    """
    Build a configuration from plain values.

    Parameters
    ----------
    model
        The configuration class.
    values
        Nested plain values, as a YAML file gives them.
    source
        File name for the error message.

    Returns
    -------
    Config
        The frozen configuration.

    Raises
    ------
    ConfigError
        With the first field that is not acceptable.

    """
    try:
        return model.model_validate(values)
    except ConfigError as error:
        raise ConfigError(error.field, error.expected, error.found, source) from None
    except ValidationError as error:
        raise _first_error(error, model, source) from None


def _first_error(
    error: ValidationError, model: type[Config], source: str,
) -> ConfigError:
    detail = error.errors(include_url=False)[0]
    field = '.'.join(str(part) for part in detail['loc']) or model.__name__
    kind, message = detail['type'], detail['msg']
    if kind == 'extra_forbidden':
        return ConfigError(field, f'a known key ({_known_keys(model, detail["loc"])})',
                           f"unknown key '{detail['loc'][-1]}'", source)
    if kind == 'missing':
        return ConfigError(field, 'a value', 'nothing', source)
    expected = message.removeprefix('Value error, ').removeprefix('Input should be ')
    return ConfigError(field, expected.removeprefix('expected '), repr(detail['input']), source)


def _known_keys(model: type[Config], location: tuple[int | str, ...]) -> str:
    """Return the keys that are known at the level of the unknown one."""
    current: Any = model
    for part in location[:-1]:
        if isinstance(current, type) and issubclass(current, BaseModel):
            field = current.model_fields.get(str(part))
            current = field.annotation if field else None
        else:  # the values of a mapping or the items of a sequence
            arguments = [x for x in get_args(current) if x is not Ellipsis]
            current = arguments[-1] if arguments else None
        if type(None) in get_args(current):
            current = next(x for x in get_args(current) if x is not type(None))
    if isinstance(current, type) and issubclass(current, BaseModel):
        return ', '.join(current.model_fields)
    return 'see the documentation'


def read_yaml(path: Path) -> dict[str, Any]:
    """
    Read a YAML mapping.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not YAML, or does not hold a mapping.

    """
    try:
        data = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ConfigError(str(path), 'a readable file', error.strerror or error) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        line = str(error).replace('\n', ' ')
        raise ConfigError(str(path), 'valid YAML', line) from None
    if not isinstance(data, dict):
        raise ConfigError(str(path), 'a mapping of keys to values', type(data).__name__)
    return data


def read_parameters(path: Path) -> dict[str, Any]:
    """
    Read the parameters of a ROS 2 parameter file with one `ros__parameters` section.

    Raises
    ------
    ConfigError
        If the file cannot be read or has no such section.

    """
    data = read_yaml(path)
    sections = [value for value in data.values() if isinstance(value, dict)]
    if len(data) != 1 or not sections or not isinstance(sections[0].get('ros__parameters'), dict):
        raise ConfigError(str(path), "one node key holding 'ros__parameters'", list(data))
    parameters: dict[str, Any] = sections[0]['ros__parameters']
    return parameters


def merge(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with the nested `overrides` laid over it."""
    merged = dict(base)
    for key, value in overrides.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            merged[key] = merge(merged[key], value)
        else:
            merged[key] = value
    return merged


def write_parameters(path: Path, config: Config) -> None:
    """Write a configuration as a ROS 2 parameter file that reads back to the same values."""
    values = config.model_dump(mode='json')
    text = yaml.safe_dump({'/**': {'ros__parameters': values}}, sort_keys=False)
    path.write_text(text, encoding='utf-8')
