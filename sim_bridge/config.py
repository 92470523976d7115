"""Everything about the simulated plant that can be chosen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from typing import Annotated, Any, Literal

from multicontact_control.config import Config, parameter, UnitVector3, Vector, Vector3
from multicontact_control.config.base import NonNegativeVector, PositiveVector
from multicontact_control.config.contact import ACROSS, ALONG, SUFFIXES
from multicontact_control.errors import ConfigError, format_count
from pydantic import AfterValidator

LARGEST_PUSH = 150.0  # N; ISO/TS 15066 lets an arm press a hand or a chest with 140 N
PUSH_TIME = 0.8  # s, of a push that is asked for, longer than a push test holds
MAX_ACTUATOR_DELAY = 5
MAX_DELAY_SUBSTEPS = 20


def choose_engine(name: str) -> str:
    """Return an engine by its name: for auto PyBullet where it is installed, else MuJoCo."""
    if name != 'auto':
        return name
    if find_spec('pybullet') is None:
        return 'mujoco'
    return 'pybullet'


def _count_errors(
    field: str, values: Sequence[Any], count: int
) -> Iterator[ConfigError]:
    """Yield an error unless there are as many values as are needed."""
    if len(values) != count:
        yield ConfigError(field, format_count(count, 'values'), len(values))


class SurfaceConfig(Config):
    """
    One compliant, rough surface that one bar tip may touch.

    Several surfaces with the same `contact` are the tips of one edge or plane.
    """

    tip_link: str = parameter(
        ...,
        'URDF link whose origin meets this surface, at the tip of the tool or anywhere on '
        'the arm.',
    )
    contact: str = parameter(
        '',
        'Contact that this tip is a part of, as an end of an edge or a corner of a plane; '
        'empty for a contact of its own, named as the surface.',
    )
    offset: tuple[float, float] = parameter(
        (0.0, 0.0),
        'Where on that contact, in half lengths along its direction and half widths '
        'across it.',
    )
    point_world: Vector3 = parameter(..., 'A point of the mean surface.', unit='m')
    normal_world: UnitVector3 = parameter(
        ..., 'Unit surface normal INTO the surface, at that point.'
    )
    shape: Literal['plane', 'cylinder', 'sphere'] = parameter(
        'plane',
        'Cylinders are curved along the track of the height profile (world x laid into '
        'the surface, or y for one that faces along x).',
    )
    radius: float = parameter(
        0.0,
        'Of a cylinder or sphere: above 0 with its centre behind the surface, as of a ball, '
        'below 0 with its centre on the side of the robot, as of a bowl.',
        unit='m',
    )
    velocity: float = parameter(
        0.0,
        'Largest speed at which the surface moves along its normal, first away from the '
        'robot if positive.',
        unit='m/s',
    )
    motion_start: float = parameter(0.0, 'When it begins to move.', unit='s', ge=0.0)
    motion_period: float = parameter(
        0.0,
        'Period of v sin(2 pi t / T), which leads it back; 0 for a constant velocity.',
        unit='s',
        ge=0.0,
    )
    stiffness: float = parameter(
        6000.0, 'Contact stiffness.', unit='N/m', live=True, gt=0.0
    )
    damping: float = parameter(30.0, 'Contact damping.', unit='N s/m', ge=0.0)
    friction: float = parameter(
        0.1, 'Coulomb friction coefficient.', live=True, ge=0.0, le=2.0
    )
    slip_speed: float = parameter(
        5e-3,
        'Sliding speed at which friction reaches 71 % of its value.',
        unit='m/s',
        gt=0.0,
    )
    roughness_std: float = parameter(
        4e-5,
        'Standard deviation of the height profile, 0 for a smooth one.',
        unit='m',
        ge=0.0,
    )
    roughness_length: float = parameter(
        1e-4,
        'Standard deviation of the Gaussian that smooths the profile.',
        unit='m',
        gt=0.0,
    )


class SensorConfig(Config):
    """The simulated wrist force/torque sensor; force before torque, x y z."""

    mounting: Vector = parameter(
        (),
        'What the mounting makes of true forces and of true torques: a 3 x 3 matrix, row by '
        'row, e.g. a rotation or -1 on the diagonal for a flipped sign; empty for nothing.',
    )
    noise: bool = parameter(True, 'Whether white noise is added.')
    force_noise_std: float = parameter(0.047, 'Noise per force axis.', unit='N', ge=0.0)
    torque_noise_std: float = parameter(
        0.004, 'Noise per torque axis.', unit='N m', ge=0.0
    )
    bias: Vector = parameter((0.0,) * 6, 'Constant offset of each axis.', unit='N, N m')
    saturate: bool = parameter(True, 'Whether readings stop at full scale.')
    full_scale: PositiveVector = parameter(
        (100.0, 100.0, 200.0, 5.0, 5.0, 5.0),
        'Largest reading of each axis.',
        unit='N, N m',
    )
    quantise: bool = parameter(True, 'Whether readings come in steps.')
    bits: int = parameter(14, 'Bits over the whole range, both signs.', ge=2, le=32)
    low_pass: bool = parameter(True, 'Whether ft_sensor/wrench_filtered is filtered.')
    low_pass_cutoff: float = parameter(
        125.0, 'Cut-off of the last of the cascaded low-passes.', unit='Hz', gt=0.0
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        yield from _count_errors('sensor.bias', self.bias, 6)
        yield from _count_errors('sensor.full_scale', self.full_scale, 6)
        if self.mounting:
            yield from _count_errors('sensor.mounting', self.mounting, 9)


class ActuationConfig(Config):
    """
    Errors of the drives, between the torque that is commanded and the one that acts.

    By default there are none. A drive makes a u + b + noise of the motor torque u, a delay later,
    and friction takes off F tanh(c v) + d v at the joint speed v. The motor torque is the
    commanded one, or with a torque loop corrects it. `torque_limit` bounds what acts. The efforts
    in joint_states are the torques that acted, on average over the control period.
    """

    seed: int = parameter(
        0,
        'Seed of a for all joints, then of b, drawn as after `numpy.random.seed`; the noise '
        'follows the seed of the run.',
        ge=0,
        le=10**9,
    )
    scale_range: tuple[float, float] = parameter(
        (1.0, 1.0), 'Lower and upper bound of a, drawn once for each joint.'
    )
    bias_range: tuple[float, float] = parameter(
        (0.0, 0.0), 'Lower and upper bound of b, drawn once for each joint.', unit='N m'
    )
    noise_std: NonNegativeVector = parameter(
        (),
        'Standard deviation of the white noise in each substep, per joint or one for all; '
        'empty for none.',
        unit='N m',
    )
    delay_substeps: int = parameter(
        0,
        'Substeps from a motor torque to its action, beside actuator_delay_ticks.',
        ge=0,
        le=MAX_DELAY_SUBSTEPS,
    )
    coulomb_friction: NonNegativeVector = parameter(
        (),
        'F, per joint or one for all; empty for none. The friction of joint_friction_scale '
        'is another one.',
        unit='N m',
    )
    friction_speed_gain: float = parameter(
        10.0, 'c, how steeply the Coulomb friction rises.', unit='s/rad', gt=0.0
    )
    viscous_friction: NonNegativeVector = parameter(
        (), 'd, per joint or one for all; empty for none.', unit='N m s/rad'
    )
    torque_loop: bool = parameter(
        False,
        'Whether the drives correct u by the error e of their torque, measured before '
        'friction: u = commanded - k_p e - k_i sum(e) - k_d de/dt.',
    )
    torque_loop_rate: float = parameter(
        1000.0,
        'Rate of the torque loop, whose period is a whole number of substeps.',
        unit='Hz',
        gt=0.0,
    )
    torque_loop_proportional: float = parameter(
        0.7, 'k_p; with k_p a above 1 the loop swings up.', ge=0.0
    )
    torque_loop_integral: float = parameter(
        0.01, 'k_i, for each step of the loop; 0.01 at 1 kHz are 10 1/s.', ge=0.0
    )
    torque_loop_derivative: float = parameter(1e-5, 'k_d.', unit='s', ge=0.0)


class PlantConfig(Config):
    """
    The simulated arm, its drives, its sensor and what it touches.

    Contacts are named as the controller names them; a contact is touched by one surface, or by the
    tips of an edge or plane, each of which has a surface of its own.
    """

    robot: str = parameter(
        'puma', 'Robot: a name of config/robots, or the path of such a file.'
    )
    engine: Annotated[
        Literal['auto', 'pybullet', 'mujoco'], AfterValidator(choose_engine)
    ] = parameter(
        'auto',
        'What works out how the arm moves; auto is pybullet where that is installed, else '
        'mujoco.',
    )
    contact: Literal['compliant', 'native'] = parameter(
        'compliant',
        'Whether surfaces push as they are configured, the same with every engine, '
        'or the contact solver of the engine does, with planes at rest and without roughness.',
    )
    home: Vector = parameter(..., 'Joint angles at the start.', unit='rad')
    gravity_world: Vector3 = parameter((0.0, 0.0, -9.81), 'Gravity.', unit='m/s^2')
    substep: float = parameter(2.5e-4, 'Integration step.', unit='s', gt=0.0)
    actuator_delay_ticks: int = parameter(
        1,
        'Control periods from a sample to the torque that answers it.',
        ge=0,
        le=MAX_ACTUATOR_DELAY,
    )
    drives: Literal['rigid', 'flexible'] = parameter(
        'flexible', 'Whether rotors and links are one or joined by springs.'
    )
    drive_stiffness: PositiveVector = parameter(
        (), 'Stiffness between rotor and link, joint side.', unit='N m/rad'
    )
    drive_damping: NonNegativeVector = parameter(
        (), 'Damping between rotor and link, joint side.', unit='N m s/rad'
    )
    joint_sensing: Literal['motor', 'joint'] = parameter(
        'motor', 'Side of the drive springs the encoders sit on.'
    )
    joint_friction_scale: float = parameter(
        0.6, 'Joint friction relative to the published one, 0 for none.', ge=0.0, le=5.0
    )
    joint_friction_speed: float = parameter(
        1e-3,
        'Joint speed scale of the smoothed Coulomb friction.',
        unit='rad/s',
        gt=0.0,
    )
    actuation: ActuationConfig = ActuationConfig()
    torque_limit: PositiveVector = parameter(
        (), "Largest joint torque; empty for the robot's own.", unit='N m'
    )
    contact_names: tuple[str, ...] = parameter(
        ..., 'Contacts in the order of every contact vector.'
    )
    obstacle_names: tuple[str, ...] = parameter(
        (), 'Surfaces that are in the way, and no contacts of the controller.'
    )
    surfaces: dict[str, SurfaceConfig]
    sensor: SensorConfig = SensorConfig()
    push_start: Vector = parameter((), 'When each push begins.', unit='s')
    push_duration: NonNegativeVector = parameter(
        (), 'How long each push lasts.', unit='s'
    )
    push_force_world: Vector = parameter(
        (),
        'Forces of the pushes at the operational point, x y z of each in turn.',
        unit='N',
    )
    tool_push_link: str = parameter(
        'tip_board',
        'URDF link, carried by the last joint, at whose origin the tool is pushed.',
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        yield from self._name_errors()
        yield from self._surface_errors()
        joints = len(self.home)
        for field in ('drive_stiffness', 'drive_damping', 'torque_limit'):
            values = getattr(self, field)
            needed = self.drives == 'flexible' and field != 'torque_limit'
            if values or needed:
                yield from _count_errors(field, values, joints)
        yield from self._actuation_errors()
        pushes = len(self.push_start)
        yield from _count_errors('push_duration', self.push_duration, pushes)
        yield from _count_errors('push_force_world', self.push_force_world, 3 * pushes)
        if self.contact == 'native':
            yield from self._native_errors()

    def _actuation_errors(self) -> Iterator[ConfigError]:
        joints = len(self.home)
        for name in ('noise_std', 'coulomb_friction', 'viscous_friction'):
            count = len(getattr(self.actuation, name))
            if count not in (0, 1, joints):
                expected = f'{joints} values, one per joint, or one for all'
                yield ConfigError(f'actuation.{name}', expected, count)

    def _name_errors(self) -> Iterator[ConfigError]:
        for field, names, known in (
            ('contact_names', self.contact_names, self.contacts.values()),
            ('obstacle_names', self.obstacle_names, self.surfaces),
        ):
            for name in names:
                if name not in known:
                    among = ', '.join(sorted(set(known)))
                    yield ConfigError(field, f'names among {among}', f"'{name}'")
        for names in (self.met, self.contact_names):
            if len(set(names)) != len(names):
                yield ConfigError(
                    'contact_names',
                    'distinct names, obstacle_names included',
                    list(names),
                )

    def _surface_errors(self) -> Iterator[ConfigError]:
        for name, surface in self.surfaces.items():
            flat = surface.shape == 'plane'
            if flat != (surface.radius == 0.0):
                yield ConfigError(
                    f'surfaces.{name}.radius',
                    '0 for a plane, and another number for what is curved',
                    f'{surface.radius:g} of a {surface.shape}',
                )
            if self.contact == 'native' and not (flat and surface.velocity == 0.0):
                yield ConfigError(
                    f'surfaces.{name}',
                    'a plane at rest with native contacts',
                    f'a {surface.shape} of velocity {surface.velocity:g} m/s',
                )

    def _native_errors(self) -> Iterator[ConfigError]:
        if self.engine != 'mujoco':
            yield ConfigError('contact', 'compliant with this engine', 'native')
        if self.drives == 'rigid' and self.joint_friction_scale > 0.0:
            yield ConfigError(
                'joint_friction_scale',
                '0 with rigid drives and native contacts',
                self.joint_friction_scale,
            )

    @property
    def contacts(self) -> dict[str, str]:
        """Name of the contact that the tip of each surface is a part of, by surface."""
        return {
            name: surface.contact or name for name, surface in self.surfaces.items()
        }

    def _surfaces_of(self, contact: str) -> list[str]:
        """Return the names of the surfaces that a contact is made of."""
        return [name for name, whose in self.contacts.items() if whose == contact]

    @property
    def touched(self) -> tuple[str, ...]:
        """Names of the surfaces that the contacts are made of, contact by contact."""
        names: list[str] = []
        for contact in self.contact_names:
            names += self._surfaces_of(contact)
        return tuple(names)

    @property
    def met(self) -> tuple[str, ...]:
        """Names of all surfaces that may be met, contacts first: the order of their records."""
        return self.touched + self.obstacle_names

    @property
    def drawn(self) -> dict[str, str]:
        """Name of one surface for each contact and obstacle: the tips of a contact share it."""
        drawn = {}
        for contact in self.contact_names:
            drawn[contact] = self._surfaces_of(contact)[0]
        for obstacle in self.obstacle_names:
            drawn[obstacle] = obstacle
        return drawn

    @property
    def columns(self) -> dict[str, dict[str, float]]:
        """
        Return forces and couples of the contacts by name, and the normal forces that make them up.

        Each as the shares of the surfaces' normal forces in it: a couple is the sum of forces
        times offsets, as `ContactConfig` of the controller counts it.
        """
        columns = {}
        for contact in self.contact_names:
            tips = self._surfaces_of(contact)
            columns[contact] = dict.fromkeys(tips, 1.0)
            for kind, axis in ((ALONG, 0), (ACROSS, 1)):
                offsets = {tip: self.surfaces[tip].offset[axis] for tip in tips}
                if any(offsets.values()):
                    columns[contact + SUFFIXES[kind]] = offsets
        return columns

    def stiffness_of(self, column: str) -> float:
        """
        Return the stiffness of the surfaces along a force or couple of `columns` [N/m].

        A tip moves by its share of the motion and makes its share of the force, so that shares
        count squared.
        """
        return sum(
            share * share * self.surfaces[name].stiffness
            for name, share in self.columns[column].items()
        )

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the forces and couples of the contacts, in the order of every vector."""
        return tuple(self.columns)

    def substeps(self, rate: float, period: str = 'control period') -> int:
        """
        Return the number of integration steps in a control period, or in another one.

        Of a rate [Hz]; ConfigError with the name of the period if the number is not whole.
        """
        ratio = 1.0 / (rate * self.substep)
        count = round(ratio)
        if count < 1 or abs(ratio - count) > 1e-6 * count:
            raise ConfigError(
                'substep',
                f'a whole fraction of the {period} {1.0 / rate:g} s',
                f'{self.substep:g} s',
            )
        return count
