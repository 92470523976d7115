"""Everything the controller needs to know."""

from __future__ import annotations

from collections.abc import Iterator
from operator import attrgetter
from typing import Literal

from multicontact_control.choices import LawName
from multicontact_control.config.base import (
    Config,
    NonNegativeVector,
    parameter,
    PositiveVector,
    Vector,
)
from multicontact_control.config.contact import (
    Column,
    ContactConfig,
    FORCE,
    KINDS,
    SUFFIXES,
)
from multicontact_control.config.force import ForceConfig, VarianceBoundsConfig
from multicontact_control.config.robot import (
    RobotConfig,
    SensorFrontEndConfig,
    ToolConfig,
)
from multicontact_control.config.supervision import (
    CollisionConfig,
    ContactStateConfig,
    LimitsConfig,
    WatchdogConfig,
)
from multicontact_control.errors import ConfigError, format_count

MAX_DELAY_PERIODS = 10
FASTEST_MOMENTUM = 0.4  # bandwidth per rate: the residual is a mean over some samples
PER_JOINT = (
    'torque_limit',
    'limits.joint_lower',
    'limits.joint_speed',
    'limits.torque_rate',
    'collision.threshold',
    'friction.coulomb',
    'friction.viscous',
    'robot.armature',
    'posture.joints',
)


class MotionConfig(Config):
    """
    The PD motion law (P04 sec. 3.1, 5.2), and what is known of its disturbances.

    f_t* = a_des + k_v (theta_des - theta) + k_p (x_des - x) - p, with k_p = omega_n^2 and
    k_v = 2 zeta omega_n; p is the disturbance that an observer finds. As published there is none.
    """

    natural_frequency: float = parameter(
        30.0,
        'Natural frequency of the motion loop.',
        unit='rad/s',
        live=True,
        gt=0.0,
        le=200.0,
    )
    damping_ratio: float = parameter(
        1.0, 'Damping ratio of the motion loop.', live=True, gt=0.0, le=5.0
    )
    observer_bandwidth: float = parameter(
        20.0,
        'Bandwidth of the observer of what disturbs the motion: joint friction, a wrong mass, '
        'a wrong scale of the torques; 0 for none.',
        unit='rad/s',
        live=True,
        ge=0.0,
        le=100.0,
    )
    friction_time: float = parameter(
        0.01,
        'Time constant by which the measured friction of the contacts is fed forward; '
        '0 for no feed-forward.',
        unit='s',
        live=True,
        ge=0.0,
        le=1.0,
    )


class PostureConfig(Config):
    """
    Motion of the joints that the operational point does not see, of an arm with more than 6.

    It acts in the null space of the task: the joints follow the posture as far as the task leaves
    them free.
    """

    natural_frequency: float = parameter(
        5.0,
        'Natural frequency, critically damped; 0 for nullspace_damping alone.',
        unit='rad/s',
        live=True,
        ge=0.0,
        le=50.0,
    )
    joints: Vector = parameter(
        (), 'The posture; empty for the one the arm starts in.', unit='rad'
    )


class FrictionConfig(Config):
    """
    Compensation of the joints' friction, which the paper's model does not have.

    Without it, friction is a disturbance that the active state of the observers has to find. It
    goes with the measured joint speeds v: F_c tanh(v / v_0) + F_v v is added to the torque.
    """

    coulomb: NonNegativeVector = parameter(
        (),
        'Coulomb friction added per joint, along its motion; empty for none.',
        unit='N m',
    )
    viscous: NonNegativeVector = parameter(
        (), 'Viscous friction added per joint; empty for none.', unit='N m s/rad'
    )
    speed: float = parameter(
        0.02,
        'Coulomb friction goes with tanh(v / speed).',
        unit='rad/s',
        live=True,
        gt=0.0,
    )


class TransitionConfig(Config):
    """
    How the torque goes over from one law to another: at a start, a stop and a live change.

    The difference of the torques fades by a quintic, over as long as both values ask for.
    """

    blend_time: float = parameter(
        0.2,
        'Shortest fade of the difference of two laws.',
        unit='s',
        live=True,
        ge=0.0,
        le=10.0,
    )
    torque_rate: float = parameter(
        100.0,
        'Largest rate at which it fades, in any joint.',
        unit='N m/s',
        live=True,
        gt=0.0,
    )
    slew_time: float = parameter(
        0.2, 'Time of a change of `tool`.', unit='s', live=True, ge=0.0, le=10.0
    )


class ControllerConfig(Config):
    """
    Everything the controller needs to know, as a parameter file says it.

    Names, lists and frames belong together: what does not fit raises a ConfigError with a line for
    each. Contacts and their couples have a fixed order, that of `columns`, in every vector.
    """

    rate: float = parameter(500.0, 'Control rate 1/h.', unit='Hz', gt=0.0)
    robot: RobotConfig
    tool: ToolConfig = ToolConfig()
    sensor: SensorFrontEndConfig = SensorFrontEndConfig()
    motion: MotionConfig = MotionConfig()
    posture: PostureConfig = PostureConfig()
    force: ForceConfig = ForceConfig()
    friction: FrictionConfig = FrictionConfig()
    transition: TransitionConfig = TransitionConfig()
    safe_behaviour: Literal['gravity_compensation', 'zero_torque', 'hold_position'] = (
        parameter(
            'gravity_compensation',
            'Command after a deactivation, the first with damping.',
            live=True,
        )
    )
    contact_names: tuple[str, ...] = parameter(
        ..., 'Contacts in the order of every contact vector.', min_length=1
    )
    contacts: dict[str, ContactConfig]
    contact_state: ContactStateConfig = ContactStateConfig()
    limits: LimitsConfig = LimitsConfig()
    watchdog: WatchdogConfig = WatchdogConfig()
    collision: CollisionConfig = CollisionConfig()
    wrench_input: Literal['raw', 'filtered', 'momentum'] = parameter(
        'raw',
        'Which wrench feeds the loop: ft_sensor/wrench, ft_sensor/wrench_filtered, or '
        'that of the joint torques, for an arm without a wrist sensor.',
    )
    initial_noise_variance: float = parameter(
        0.6, 'R until an estimate arrives.', unit='N^2', gt=0.0
    )
    noise_variance: VarianceBoundsConfig = VarianceBoundsConfig()
    torque_limit: PositiveVector = parameter(
        (), 'Largest commanded torque per joint; empty for none.', unit='N m'
    )
    nullspace_damping: float = parameter(
        2.0,
        'Least joint damping in the null space, of redundant arms and at singularities.',
        unit='1/s',
        ge=0.0,
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        joints = len(self.robot.joint_names)
        for name in PER_JOINT:
            count = len(attrgetter(name)(self))
            if count not in (0, joints):
                yield ConfigError(
                    name, f'{format_count(joints, "values")}, one per joint', count
                )
        for name in ('sensor.frozen_ticks', 'watchdog.frozen_joint_ticks'):
            if attrgetter(name)(self) == 1:
                yield ConfigError(name, '0, or at least 2', 1)
        names = self.contact_names
        if len(self.contacts.keys() & set(names)) < len(names):
            known = ', '.join(sorted(self.contacts))
            yield ConfigError(
                'contact_names', f'distinct names among {known}', list(names)
            )
        else:
            yield from self._force_law_errors()
            yield from self._tool_turn_errors()
        without_sensor = self.wrench_input == 'momentum'
        if without_sensor == bool(self.robot.sensor_frame):
            yield ConfigError(
                'robot.sensor_frame',
                'a link of the robot with a wrist sensor, and '
                'empty with wrench_input momentum',
                f"'{self.robot.sensor_frame}'",
            )
        if without_sensor and self.sensor.require_push_test:
            yield ConfigError(
                'sensor.require_push_test', 'false without a wrist sensor', True
            )
        bounds = self.noise_variance
        initial = self.initial_noise_variance
        if not bounds.smallest <= initial <= bounds.largest:
            yield ConfigError(
                'initial_noise_variance',
                f'{bounds.smallest:g} to {bounds.largest:g} N^2 (noise_variance)',
                initial,
            )
        yield from self._delay_errors()

    def _force_law_errors(self) -> Iterator[ConfigError]:
        """Yield an error for each choice of the force laws that others rule out."""
        force = self.force
        adaptive = force.stiffness == 'adaptive'
        laws = {self.force_law_of(name) for name in self.contact_names}
        other_laws = sorted(laws - {'aob'})
        for name in self.contact_names:
            contact = self.contacts[name]
            if contact.normal_turn_rate and not contact.friction_std:
                yield ConfigError(
                    f'contacts.{name}.friction_std',
                    'above 0 N with normal_turn_rate',
                    0.0,
                )
            if contact.surface_speed_limit and self.force_law_of(name) != 'aob':
                # The estimate takes the rate of the force from the observer.
                yield ConfigError(
                    f'contacts.{name}.surface_speed_limit',
                    '0 m/s unless force.law is aob',
                    contact.surface_speed_limit,
                )
        need_decoupling = list(self._needs_of_decoupling(other_laws))
        if need_decoupling and force.allocation != 'decoupled':
            yield ConfigError(
                'force.allocation',
                f'decoupled with {", ".join(need_decoupling)}',
                force.allocation,
            )
        if adaptive and (other_laws or not force.active_state_order):
            yield ConfigError(
                'force.stiffness',
                'configured unless every law is aob, with an active state',
                force.stiffness,
            )
        if adaptive and not force.damping_rate:
            yield ConfigError(
                'force.damping_rate', 'above 0 with adaptive stiffness', 0.0
            )

    def _tool_turn_errors(self) -> Iterator[ConfigError]:
        """Yield an error for each contact that cannot turn the tool."""
        turning = []
        for name in self.contact_names:
            contact = self.contacts[name]
            if not contact.tool_turn_limit:
                continue
            turning.append(name)
            if not contact.normal_turn_rate:
                yield ConfigError(
                    f'contacts.{name}.normal_turn_rate',
                    'above 0 rad/s with tool_turn_limit',
                    0.0,
                )
            if contact.type != 'point':  # its couples turn the tool
                yield ConfigError(
                    f'contacts.{name}.tool_turn_limit',
                    f'0 rad at a contact of type {contact.type}',
                    contact.tool_turn_limit,
                )
        if len(turning) > 1:
            yield ConfigError(
                'contacts',
                'tool_turn_limit above 0 rad at one contact at most',
                ', '.join(turning),
            )

    def _needs_of_decoupling(self, other_laws: list[LawName]) -> Iterator[str]:
        """Yield all that needs contacts that move no other one, unlike N alpha* (P04 eq. 30)."""
        for law in other_laws:
            yield f'the law {law}'
        if self.force.stiffness == 'adaptive':
            yield 'adaptive stiffness'
        for name in self.contact_names:
            contact = self.contacts[name]
            if contact.type != 'point':
                yield f'the {contact.type} {name}'
            if contact.surface_speed:
                yield f'contacts.{name}.surface_speed'
            if contact.surface_speed_limit:
                yield f'contacts.{name}.surface_speed_limit'

    def _delay_errors(self) -> Iterator[ConfigError]:
        """Yield an error for a low-pass beyond half the rate, or a delay that no model has."""
        sensor = self.sensor
        nyquist = 0.5 * self.rate
        if sensor.filter_order and sensor.filter_cutoff >= nyquist:
            yield ConfigError(
                'sensor.filter_cutoff',
                f'below {nyquist:g} Hz, half the rate',
                sensor.filter_cutoff,
            )
        elif self.loop_delay * self.rate > MAX_DELAY_PERIODS + 1e-9:
            yield ConfigError(
                'force.input_delay',
                f'at most {MAX_DELAY_PERIODS / self.rate:g} s with the delay '
                'of sensor.filter_cutoff and, by momentum, 1 / collision.bandwidth',
                f'{self.loop_delay:.4g} s',
            )

    @property
    def loop_delay(self) -> float:
        """
        T_d of the force loop: force.input_delay and that of the measurement of forces [s].

        The observers' model has it as delayed inputs, of at most `MAX_DELAY_PERIODS` control
        periods.
        """
        return self.force.input_delay + self.measuring_delay

    @property
    def measuring_delay(self) -> float:
        """
        Delay of the low-pass of the wrench and, by momentum, of its observer [s].

        Both are the controller's own, so it adds them by itself; `force.input_delay` is what a
        user states.
        """
        delay = self.sensor.filter_delay(self.rate)
        if self.wrench_input == 'momentum':
            delay += 1.0 / self.momentum_bandwidth
        return delay

    @property
    def columns(self) -> tuple[Column, ...]:
        """
        Return the controlled coordinates of all contacts, in the order of every vector.

        A point has one, its normal force; an edge has a couple more, a plane two. A couple's
        stiffness is that which is configured, or else a third of the normal one, as of a uniform
        surface.
        """
        columns: list[Column] = []
        for name in self.contact_names:
            contact = self.contacts[name]
            couple_stiffness = contact.couple_stiffness or 1.0 / 3.0 * contact.stiffness
            half_lengths = (0.0, contact.half_length, contact.half_width)
            leader = len(columns)
            for kind in KINDS[contact.type]:
                stiffness = couple_stiffness
                if kind == FORCE:
                    stiffness = contact.stiffness
                columns.append(
                    Column(
                        name=name + SUFFIXES[kind],
                        contact=name,
                        kind=kind,
                        leader=leader,
                        stiffness=stiffness,
                        half_length=half_lengths[kind],
                    )
                )
        return tuple(columns)

    @property
    def column_names(self) -> tuple[str, ...]:
        """
        Return the names of the controlled coordinates, in their order.

        That of a normal force is the name of its contact; couples have a suffix, ``blade/along``.
        """
        return tuple(column.name for column in self.columns)

    @property
    def leading_columns(self) -> tuple[int, ...]:
        """
        For each column the index of the column with the normal force of its contact.

        For a normal force that is its own index; a couple means something only while its leader
        presses.
        """
        return tuple(column.leader for column in self.columns)

    @property
    def force_columns(self) -> tuple[int, ...]:
        """
        Return the indices of the columns that are normal forces, one per contact, in their order.

        Counts of contacts and lists of their names go by them; couples are left out.
        """
        return tuple(i for i, column in enumerate(self.columns) if column.kind == FORCE)

    def force_law_of(self, contact: str) -> LawName:
        """
        Return the name of the law that controls a contact: its own, or else `force.law`.

        `contact` is one of `contact_names`; KeyError for any other. The couples of a contact have
        its law.
        """
        own_law = self.contacts[contact].law
        return own_law or self.force.law

    @property
    def momentum_bandwidth(self) -> float:
        """
        Return the bandwidth K of the momentum observer [1/s].

        The rate bounds it: a residual is a mean over some samples.
        """
        return min(self.collision.bandwidth, FASTEST_MOMENTUM * self.rate)

    @property
    def wrench_series(self) -> str:
        """
        Return the name of the wrench that feeds the loop, in samples and recordings.

        A wrench by momentum passes the controller's own low-pass, and so is a filtered one.
        """
        if self.wrench_input == 'raw':
            return 'wrench'
        return 'wrench_filtered'

    @property
    def period(self) -> float:
        """
        Return the control period h, of which delays and ages are multiples [s].

        A sample is to come every h, and be answered within it.
        """
        return 1.0 / self.rate
