"""
The records that compiled code works on: every field with its shape and unit.

They are handed over as arrays, also of one element: numba takes a lone record ten times slower.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, overload, Protocol, TypeVar

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import MAX_DELAY_PERIODS
import numpy as np

RecordT_co = TypeVar('RecordT_co', covariant=True)


class Record(Protocol):
    """
    One record: beside every dtype stands what is derived of this, for editors and type checkers.

    Compiled code reads and writes the fields as attributes, Python by their names.
    """

    def __getitem__(self, field: str) -> Any:
        """Return a field."""

    def __setitem__(self, field: str, value: Any) -> None:
        """Set a field."""


class Records(Protocol[RecordT_co]):
    """
    An array of records of one type, which numpy's arrays of their dtype are taken for.

    A field of all is an array of numbers, or again of records.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        """Return how many there are."""

    def __len__(self) -> int:
        """Return how many there are."""

    def __iter__(self) -> Iterator[RecordT_co]:
        """Go through them."""

    # In the order in which numpy declares the same, or a type checker does not find it there.
    @overload
    def __getitem__(self, place: Mask) -> Records[RecordT_co]: ...

    @overload
    def __getitem__(self, place: int) -> RecordT_co: ...

    @overload
    def __getitem__(self, place: slice) -> Records[RecordT_co]: ...

    @overload
    def __getitem__(self, place: str) -> Any: ...

    def __setitem__(self, place: Any, value: Any) -> None:
        """Set some of them, or a field of all."""

    def copy(self) -> Records[RecordT_co]:
        """Return a copy."""


F, I, B = np.float64, np.int64, np.bool_

MAX_ORDER = 3  # of an observer's active state
MAX_STATES = 2 + MAX_DELAY_PERIODS + MAX_ORDER  # force, its rate, delayed inputs, active states
MAX_JOINTS = 12  # of an arm
MAX_COLUMNS = 6  # of N: more are always dependent

# What is set for the control law and for taking the measured wrench apart; one.
LAW = np.dtype([
    ('k_p', F), ('k_v', F),  # position and velocity gain of the motion law [1/s^2], [1/s]
    ('K_2', F),  # damping of the force loops [1/s]
    ('friction_speed', F),  # v_0 of the joints' Coulomb friction [rad/s]
    ('nullspace_damping', F),  # d [1/s]
    ('posture_stiffness', F),  # k_q of the posture in the null space, 0 for none [1/s^2]
    ('stop_stiffness', F),  # k_s by which joints are kept off their stops there [1/s^2]
    ('least_share', F),  # s_0 of what goes beyond the priority, at a torque limit
    ('singular_mobility', F),  # eigenvalue up to which Lambda^-1 is damped, 0 for none [1/kg]
    ('inertia_metric', B),  # whether motion is kept off the contacts in the metric of Lambda
    ('decoupled', B),  # whether the contact points are driven, or the coordinates along N_i
    ('separated', B),  # whether friction is expected or allowed for in the measured wrench
    ('force_noise', F), ('torque_noise', F),  # of the wrist sensor, per axis [N], [N m]
    ('period', F),  # h [s]
], align=True)


class Law(Record, Protocol):
    """A record of `LAW`."""

    k_p: float
    k_v: float
    K_2: float
    friction_speed: float
    nullspace_damping: float
    posture_stiffness: float
    stop_stiffness: float
    least_share: float
    singular_mobility: float
    inertia_metric: bool
    decoupled: bool
    separated: bool
    force_noise: float
    torque_noise: float
    period: float


# What the residual of a joint has followed: `REGRESSORS` of `control.arm`; sums fade within 1 s.
EVIDENCE = np.dtype([
    ('regressor', F, 4), ('square', F, 4),  # the newest, and the sum of their squares
    ('product', F, 4),  # sum of each times what the residual is beyond `at_rest`
    ('power', F),  # sum of the squares of that [N^2 m^2]
    ('at_rest', F), ('rested', F),  # its mean at rest in the first 0.2 s [N m], and of those [s]
    ('friction', F), ('moved', F),  # mean along the first 0.5 s of motion [N m], and of those [s]
    ('mean_square', F),  # along them [N^2 m^2]
    ('area', F),  # integral of the same since the arm was calm last [N m s]
    ('felt_before', F),  # J_i^T f when it was [N m]
], align=True)


class Evidence(Record, Protocol):
    """A record of `EVIDENCE`."""

    regressor: Vector
    square: Vector
    product: Vector
    power: float
    at_rest: float
    rested: float
    friction: float
    moved: float
    mean_square: float
    area: float
    felt_before: float


# What is set for one joint.
JOINT_CONFIG = np.dtype([
    ('coulomb', F), ('viscous', F),  # friction to compensate [N m], [N m s/rad]
    ('lower', F), ('upper', F),  # stops [rad]
    ('posture', F),  # q_0, where the null space takes it [rad]
    ('torque_limit', F),  # of the command [N m]
    ('torque_step', F),  # of what is commanded, per period [N m]
    ('gate_speed', F),  # to which the gate brakes it [rad/s]
    ('speed_limit', F),  # beyond which it is too fast [rad/s]
    ('least_threshold', F),  # of the residual, without friction [N m]
    ('allowance', F), ('learnt_limit', F),  # friction in it, at least and at most [N m]
], align=True)


class JointConfig(Record, Protocol):
    """A record of `JOINT_CONFIG`."""

    coulomb: float
    viscous: float
    lower: float
    upper: float
    posture: float
    torque_limit: float
    torque_step: float
    gate_speed: float
    speed_limit: float
    least_threshold: float
    allowance: float
    learnt_limit: float


# What the collision watch knows of one joint.
JOINT_WATCH = np.dtype([
    ('effort', F),  # torque that acted since the sample before [N m]
    ('effort_fault', I),  # why that is not measured; see `supervision.inputs`
    ('unwatched', B),  # whether it is not known, neither measured nor commanded
    ('last_velocity', F), ('last_bias', F),  # of that sample [rad/s], [N m]
    ('residual', F),  # of the torques: what neither model nor wrist sensor explains [N m]
    ('doubt', F),  # by how much the effort may be another [N m]
    ('threshold', F),  # of the residual, from which on it counts, at rest [N m]
    ('slack', F),  # added to that, as the arm accelerates or the effort is in doubt [N m]
    ('evidence', EVIDENCE),
], align=True)


class JointWatch(Record, Protocol):
    """A record of `JOINT_WATCH`."""

    effort: float
    effort_fault: int
    unwatched: bool
    last_velocity: float
    last_bias: float
    residual: float
    doubt: float
    threshold: float
    slack: float
    evidence: Evidence


# What the control law answers for one joint.
JOINT_ANSWER = np.dtype([
    ('torque', F),  # Gamma [N m]
    ('unlimited', F),  # the same before it is brought within its limits [N m]
    ('priority', F),  # of that, what goes before the rest at a limit: see `finish_torque` [N m]
], align=True)


class JointAnswer(Record, Protocol):
    """A record of `JOINT_ANSWER`."""

    torque: float
    unlimited: float
    priority: float


# What the last gate remembers of one joint, and what is left of the torques before.
JOINT_GATE = np.dtype([
    ('lower', F), ('upper', F),  # positions at which it comes to rest [rad]
    ('last', F),  # what was commanded last and what was added [N m]
    ('lacking', F), ('difference', F),  # see `supervision.gate.blend` [N m]
], align=True)


class JointGate(Record, Protocol):
    """A record of `JOINT_GATE`."""

    lower: float
    upper: float
    last: float
    lacking: float
    difference: float


# One joint: what is set for it, where it is and its terms of the arm's model, and what is made of
# that on the way to its torque.
JOINT = np.dtype([
    ('config', JOINT_CONFIG),
    ('q', F),  # position [rad]
    ('velocity', F),  # [rad/s]
    ('inertia', F),  # diagonal element of M [kg m^2]
    ('bias_torque', F),  # element of C v + g [N m]
    ('added', F),  # to the command by the drives themselves, 0 if they add nothing [N m]
    ('watch', JOINT_WATCH),
    ('answer', JOINT_ANSWER),
    ('gate', JOINT_GATE),
], align=True)


class Joint(Record, Protocol):
    """A record of `JOINT`."""

    config: JointConfig
    q: float
    velocity: float
    inertia: float
    bias_torque: float
    added: float
    watch: JointWatch
    answer: JointAnswer
    gate: JointGate


# What is set for the operational frame.
FRAME_CONFIG = np.dtype([
    ('speed_limit', F), ('turn_limit', F),  # beyond which it is too fast [m/s], [rad/s]
], align=True)


class FrameConfig(Record, Protocol):
    """A record of `FRAME_CONFIG`."""

    speed_limit: float
    turn_limit: float


# The operational frame and the wrist sensor's, world axes; one.
FRAME = np.dtype([
    ('config', FRAME_CONFIG),
    ('position', F, 3),  # operational point [m]
    ('rotation', F, (3, 3)),  # axes of the operational frame as columns
    ('twist', F, 6),  # theta = J v [m/s, rad/s]
    ('sensor_position', F, 3),  # [m]
    ('sensor_rotation', F, (3, 3)),  # axes of the sensor as columns
    ('mobility', F),  # smallest eigenvalue of Lambda^-1 where the law was asked last [1/kg]
], align=True)


class Frame(Record, Protocol):
    """A record of `FRAME`."""

    config: FrameConfig
    position: Vector
    rotation: Matrix
    twist: Vector
    sensor_position: Vector
    sensor_rotation: Matrix
    mobility: float


# What hangs on the wrist sensor; one.
TOOL = np.dtype([
    ('com_sensor', F, 3),  # centre of mass in the sensor frame [m]
    ('weight', F, 3),  # m g, world axes [N]
    ('bias', F, 6),  # the sensor's reading under no load, in its frame [N, N m]
    ('mass', F),  # m [kg]
], align=True)


class Tool(Record, Protocol):
    """A record of `TOOL`."""

    com_sensor: Vector
    weight: Vector
    bias: Vector
    mass: float


# What is set for the generalised-momentum observer.
MOMENTUM_CONFIG = np.dtype([
    ('bandwidth', F),  # K [1/s], 0 for none
    ('dynamic_share', F),  # of what accelerates the arm, added to the thresholds
    ('is_input', B),  # whether the residual is the wrench of the contacts: there is no sensor
], align=True)


class MomentumConfig(Record, Protocol):
    """A record of `MOMENTUM_CONFIG`."""

    bandwidth: float
    dynamic_share: float
    is_input: bool


# The generalised-momentum observer; one.
MOMENTUM = np.dtype([
    ('config', MOMENTUM_CONFIG),
    ('elapsed', F),  # since the sample before; 0 if it is not known what acted since then [s]
    ('com_velocity', F, 3),  # of what hangs on the sensor, at the sample before [m/s]
    ('collided', B),  # whether a residual is beyond its threshold
    ('calm', F),  # for how long all of them have been small [s]
    ('touched', B),  # whether one has been beyond it since they were
], align=True)


class Momentum(Record, Protocol):
    """A record of `MOMENTUM`."""

    config: MomentumConfig
    elapsed: float
    com_velocity: Vector
    collided: bool
    calm: float
    touched: bool


# Where the operational frame is to be, world axes.
TASK = np.dtype([
    ('position', F, 3),  # x_des [m]
    ('rotation', F, (3, 3)),  # desired axes of the operational frame as columns
    ('twist', F, 6),  # theta_des [m/s, rad/s]
    ('acceleration', F, 6),  # a_des [m/s^2, rad/s^2]
], align=True)


class Task(Record, Protocol):
    """A record of `TASK`."""

    position: Vector
    rotation: Matrix
    twist: Vector
    acceleration: Vector


# All that the control law works on besides joints, contacts and observers; one.
CONTROL = np.dtype([
    ('law', LAW), ('frame', FRAME), ('tool', TOOL), ('momentum', MOMENTUM),
    ('wanted', TASK),  # what the source of the task asks for
    ('task', TASK),  # what the motion law is asked for: that, as far as contacts and limits allow
    ('wrench', F, 6),  # what the wrist sensor reads, in its frame [N, N m]
    ('measured', B),  # whether that is of this sample; if not, observers only predict
], align=True)


class Control(Record, Protocol):
    """A record of `CONTROL`."""

    law: Law
    frame: Frame
    tool: Tool
    momentum: Momentum
    wanted: Task
    task: Task
    wrench: Vector
    measured: bool


# What the force law answers for one contact, all 0 where no law controls it.
FORCE_ANSWER = np.dtype([
    ('active', B),  # whether its force is controlled
    ('alpha_des', F),  # desired force [N]
    ('alpha_fed', F),  # force fed forward [N]
    ('alpha_est', F), ('alpha_rate_est', F),  # estimated force and its rate [N], [N/s]
    ('innovation', F),  # alpha_meas - C x_1, 0 where nothing was predicted [N]
    ('prior_variance', F),  # C P_1 C^T, 0 there as well [N^2]
    ('variance_used', F),  # R the observer worked with, 0 there as well [N^2]
], align=True)


class ForceAnswer(Record, Protocol):
    """A record of `FORCE_ANSWER`."""

    active: bool
    alpha_des: float
    alpha_fed: float
    alpha_est: float
    alpha_rate_est: float
    innovation: float
    prior_variance: float
    variance_used: float


# What is configured of one column of N: the normal force of a contact, or one of its couples.
CONTACT_CONFIG = np.dtype([
    ('kind', I),  # FORCE, ALONG or ACROSS, see `config.contact`
    ('leader', I),  # index of the normal force of the same contact
    ('normal', F, 3),  # unit normal INTO the surface, world axes; 0 for couples
    ('point', F, 3),  # contact point, or centre, in the operational frame [m]
    ('direction', F, 3),  # of an edge, or of a plane's first side, in the operational frame
    ('half_length', F),  # unit of a couple's lever, 0 for a force [m]
    ('friction_std', F),  # of friction that is allowed for, 0 for couples [N]
    ('torsion_std', F),  # of its torque about the normal [N m]
    ('friction_coefficient', F),  # that is expected while sliding, 0 for couples
    ('normal_gain', F),  # share of the way that the estimated normal goes per period
    ('turn_limit', F),  # how far it goes per period at most, 0 where it is not estimated [rad]
    ('smallest_cosine', F),  # of the angle between it and the one configured
    ('surface_speed', F),  # of the surface along its normal [m/s]
    ('surface_gain', F),  # share of the way that its estimate goes per period
    ('surface_speed_limit', F),  # bound of that, 0 where it is not estimated [m/s]
], align=True)


class ContactConfig(Record, Protocol):
    """A record of `CONTACT_CONFIG`."""

    kind: int
    leader: int
    normal: Vector
    point: Vector
    direction: Vector
    half_length: float
    friction_std: float
    torsion_std: float
    friction_coefficient: float
    normal_gain: float
    turn_limit: float
    smallest_cosine: float
    surface_speed: float
    surface_gain: float
    surface_speed_limit: float


# One column of N, couples in newtons: what is configured, measured and learnt, and answered.
CONTACT = np.dtype([
    ('config', CONTACT_CONFIG),
    ('N', F, 6),  # column of N: the wrench of a unit force, world axes
    ('alpha_meas', F),  # measured force, without `untared` [N]
    ('untared', F),  # what was read in free space, before a touch [N]
    ('speed_bound', F),  # into a surface that has not answered, 0 for none [m/s]
    ('borne', F),  # what such a surface was found to bear, as an acceleration [m/s^2]
    ('noise_variance', F),  # R_k [N^2]
    ('guarded', B),  # whether the measured force is fed forward, as the surface seems to be gone
    ('normal', F, 3),  # estimated unit normal, world axes
    ('surface_speed_est', F),  # what is added to the configured speed, estimated [m/s]
    ('friction', F, 3),  # found, world axes [N]
    ('stiffness', F),  # k of the model in use [N/m]
    ('mobility', F),  # N^T Lambda^-1 N of the newest answer, 0 before the first [1/kg]
    ('stiffness_est', F), ('stiffness_std', F),  # estimate of k, 0 for none; its error [N/m]
    ('ratio_bound', F),  # largest likely true stiffness over that of the model in use
    ('margin', F),  # largest ratio at which the force loop is stable, over that one
    ('wanted', B),  # whether the source of the task asks for it
    ('alpha_wanted', F),  # force that it asks for [N]
    ('answer', FORCE_ANSWER),
], align=True)


class Contact(Record, Protocol):
    """A record of `CONTACT`."""

    config: ContactConfig
    N: Vector
    alpha_meas: float
    untared: float
    speed_bound: float
    borne: float
    noise_variance: float
    guarded: bool
    normal: Vector
    surface_speed_est: float
    friction: Vector
    stiffness: float
    mobility: float
    stiffness_est: float
    stiffness_std: float
    ratio_bound: float
    margin: float
    wanted: bool
    alpha_wanted: float
    answer: ForceAnswer


# What has come in at a tick, as Python writes it; one. What of it is valid, and where it goes, is
# in `supervision.inputs`.
INPUT = np.dtype([
    ('time', F),  # of the tick, NaN if it is not a number [s]
    # Whether what is asked for is there and has the right shape: FINE, ABSENT or INVALID, of
    # `supervision.inputs`. Joint states may come without velocities and without efforts.
    ('joints_came', I), ('velocity_came', I), ('effort_came', I),
    ('wrench_came', I), ('variance_came', I),
    ('command_came', B),  # whether there is one of the tick before
    ('joints_stamp', F), ('wrench_stamp', F), ('variance_stamp', F),  # when it was sampled [s]
    ('q', F, MAX_JOINTS), ('velocity', F, MAX_JOINTS),  # [rad], [rad/s]
    ('effort', F, MAX_JOINTS),  # torques measured over the period before [N m]
    ('command', F, MAX_JOINTS),  # torques commanded at the tick before [N m]
    ('wrench', F, 6),  # what the wrist sensor reads, in its frame [N, N m]
    ('variance', F, MAX_COLUMNS),  # R of each column of N [N^2]
], align=True)


class Input(Record, Protocol):
    """A record of `INPUT`."""

    time: float
    joints_came: int
    velocity_came: int
    effort_came: int
    wrench_came: int
    variance_came: int
    command_came: bool
    joints_stamp: float
    wrench_stamp: float
    variance_stamp: float
    q: Vector
    velocity: Vector
    effort: Vector
    command: Vector
    wrench: Vector
    variance: Vector

