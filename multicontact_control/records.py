"""
The records that compiled code works on: every field with its shape and unit.

They are handed over as arrays, also of one element: numba takes a lone record ten times slower.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import (
    Annotated,
    Any,
    get_args,
    get_origin,
    get_type_hints,
    overload,
    Protocol,
    TypeVar,
)

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import MAX_DELAY_PERIODS
import numpy as np
from numpy.typing import NDArray

RecordT_co = TypeVar('RecordT_co', covariant=True)


class Record(Protocol):
    """
    One record: what is derived of this names the fields, for editors and type checkers.

    `record_dtype` makes its dtype. Compiled code reads and writes the fields as attributes,
    Python by their names.
    """

    def __getitem__(self, field: str) -> Any:
        """Return a field by its name."""

    def __setitem__(self, field: str, value: Any) -> None:
        """Set a field by its name."""


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


NUMBERS: dict[object, type[np.generic]] = {
    float: np.float64,
    int: np.int64,
    bool: np.bool_,
}


def record_dtype(record: type) -> np.dtype[np.void]:
    """
    Return the dtype of a record, which has the fields of its type, in their order.

    `Annotated[Vector, 3]` is a field of three numbers, `Annotated[Records[Joint], 12]` one of
    twelve records.
    """
    fields: list[tuple[Any, ...]] = []
    for name, kind in get_type_hints(record, include_extras=True).items():
        element, shape = describe_field(kind)
        if not issubclass(element, np.generic):
            element = record_dtype(element)
        fields.append((name, element, shape))
    return np.dtype(fields, align=True)


def describe_field(kind: Any) -> tuple[Any, tuple[int, ...]]:
    """Return the element of a field, a type of numpy or a record, and its shape, () for one."""
    if get_origin(kind) is Annotated:
        array, *shape = get_args(kind)
        return describe_field(array)[0], tuple(shape)
    if get_origin(kind) is Records:
        return describe_field(get_args(kind)[0])
    # From numpy 2.5 on NDArray is an alias with a name of its own.
    if get_origin(kind) is NDArray:
        return get_args(kind)[0], ()
    if get_origin(kind) is np.ndarray:
        element = get_args(kind)[1]
        return get_args(element)[0], ()
    return NUMBERS.get(kind, kind), ()


MAX_ORDER = 3  # of an observer's active state
# Force, its rate, delayed inputs, active states.
MAX_STATES = 2 + MAX_DELAY_PERIODS + MAX_ORDER
MAX_JOINTS = 12  # of an arm
MAX_COLUMNS = 6  # of N: more are always dependent


class Law(Record, Protocol):
    """What is set for the control law and for taking the measured wrench apart; one."""

    # Position and velocity gain of the motion law [1/s^2], [1/s].
    k_p: float
    k_v: float

    K_2: float  # damping of the force loops [1/s]
    friction_speed: float  # v_0 of the joints' Coulomb friction [rad/s]
    nullspace_damping: float  # d [1/s]
    posture_stiffness: float  # k_q of the posture in the null space, 0 for none [1/s^2]
    stop_stiffness: float  # k_s by which joints are kept off their stops there [1/s^2]
    least_share: float  # s_0 of what goes beyond the priority, at a torque limit

    # Eigenvalue up to which Lambda^-1 is damped, 0 for none [1/kg].
    singular_mobility: float

    # Whether motion is kept off the contacts in the metric of Lambda.
    inertia_metric: bool

    # Whether the contact points are driven, or the coordinates along N_i.
    decoupled: bool

    # Whether friction is expected or allowed for in the measured wrench.
    separated: bool

    # Of the wrist sensor, per axis [N], [N m].
    force_noise: float
    torque_noise: float

    period: float  # h [s]


LAW = record_dtype(Law)


class ResidualStatistics(Record, Protocol):
    """
    What the residual of a joint has followed.

    The candidates are the `REGRESSORS` of `control.arm`; sums fade within 1 s.
    """

    # The newest, and the sum of their squares.
    regressor: Annotated[Vector, 4]
    regressor_power: Annotated[Vector, 4]

    # Sum of each times what the residual is beyond `residual_at_rest`.
    correlation: Annotated[Vector, 4]

    residual_power: float  # sum of the squares of that [N^2 m^2]

    # Its mean at rest in the first 0.2 s [N m], and of those [s].
    residual_at_rest: float
    time_at_rest: float

    # Mean along the first 0.5 s of motion [N m], and of those [s].
    friction: float
    time_in_motion: float

    mean_square: float  # along them [N^2 m^2]
    residual_integral: float  # integral of the same since the arm was calm last [N m s]
    calm_wrench_torque: float  # J_i^T f when it was [N m]


class JointConfig(Record, Protocol):
    """What is set for one joint: friction, stops, limits, and thresholds of its residual."""

    # Friction to compensate [N m], [N m s/rad].
    coulomb: float
    viscous: float

    # Stops [rad].
    lower: float
    upper: float

    # q_0, where the null space takes it, and what is told for that, NaN for where it is [rad].
    posture: float
    told_posture: float

    torque_limit: float  # of the command [N m]
    torque_step: float  # of what is commanded, per period [N m]
    gate_speed: float  # to which the gate brakes it [rad/s]
    speed_limit: float  # beyond which it is too fast [rad/s]
    least_threshold: float  # of the residual, without friction [N m]

    # Friction in it, at least and at most [N m].
    declared_friction: float
    learnt_friction_limit: float


class JointWatch(Record, Protocol):
    """
    What the collision watch knows of one joint: the torque that acted, and what explains it.

    The residual counts as a touch beyond `threshold + dynamic_threshold`.
    """

    effort: float  # torque that acted since the sample before [N m]
    effort_fault: int  # why that is not measured; see `supervision.input_checks`
    unwatched: bool  # whether it is not known, neither measured nor commanded

    # Of that sample [rad/s], [N m].
    previous_velocity: float
    previous_bias_torque: float

    # Of the torques: what neither model nor wrist sensor explains [N m].
    residual: float

    effort_uncertainty: float  # by how much the effort may be another [N m]
    threshold: float  # of the residual, from which on it counts, at rest [N m]

    # Added to that, as the arm accelerates or the effort is in doubt [N m].
    dynamic_threshold: float

    residual_statistics: ResidualStatistics


class JointAnswer(Record, Protocol):
    """What the control law answers for one joint, and what goes before the rest at a limit."""

    torque: float  # Gamma [N m]
    unlimited: float  # the same before it is brought within its limits [N m]

    # Of that, what goes before the rest at a limit: see `limit_torque` [N m].
    priority: float


class JointGate(Record, Protocol):
    """What the last gate remembers of one joint, and what is left of the torques before."""

    # Positions at which it comes to rest [rad].
    lower: float
    upper: float

    commanded_torque: float  # what was commanded last and what was added [N m]

    # See `supervision.gate.blend_torque` [N m].
    blended_difference: float
    faded_difference: float


class Joint(Record, Protocol):
    """
    One joint of the arm.

    What is set for it, where it is and its terms of the arm's model, and what is made of that
    on the way to its torque.
    """

    config: JointConfig
    q: float  # position [rad]
    velocity: float  # [rad/s]
    inertia: float  # diagonal element of M [kg m^2]
    bias_torque: float  # element of C v + g [N m]

    # To the command by the drives themselves, 0 if they add nothing [N m].
    drive_gravity_torque: float

    watch: JointWatch
    answer: JointAnswer
    gate: JointGate


JOINT = record_dtype(Joint)


class FrameConfig(Record, Protocol):
    """What is set for the operational frame: speeds beyond which the arm is too fast."""

    # Beyond which it is too fast [m/s], [rad/s].
    speed_limit: float
    turn_limit: float


class Frame(Record, Protocol):
    """The operational frame and the wrist sensor's, world axes; one."""

    config: FrameConfig
    position: Annotated[Vector, 3]  # operational point [m]
    rotation: Annotated[Matrix, 3, 3]  # axes of the operational frame as columns
    twist: Annotated[Vector, 6]  # theta = J v [m/s, rad/s]
    sensor_position: Annotated[Vector, 3]  # [m]
    sensor_rotation: Annotated[Matrix, 3, 3]  # axes of the sensor as columns

    # Smallest eigenvalue of Lambda^-1 where the law was asked last [1/kg].
    mobility: float


FRAME = record_dtype(Frame)


class Tool(Record, Protocol):
    """What hangs on the wrist sensor, whose weight is taken off the readings; one."""

    com_sensor: Annotated[Vector, 3]  # centre of mass in the sensor frame [m]
    weight: Annotated[Vector, 3]  # m g, world axes [N]

    # The sensor's reading under no load, in its frame [N, N m].
    bias: Annotated[Vector, 6]

    mass: float  # m [kg]


TOOL = record_dtype(Tool)


class MomentumConfig(Record, Protocol):
    """What is set for the generalised-momentum observer, which watches for collisions."""

    bandwidth: float  # K [1/s], 0 for none
    dynamic_share: float  # of what accelerates the arm, added to the thresholds

    # Whether the residual is the wrench of the contacts: there is no sensor.
    is_input: bool


class Momentum(Record, Protocol):
    """The generalised-momentum observer, whose residuals are in the joints; one."""

    config: MomentumConfig

    # Since the sample before; 0 if it is not known what acted since then [s].
    elapsed: float

    # Of what hangs on the sensor, at the sample before [m/s].
    com_velocity: Annotated[Vector, 3]

    collided: bool  # whether a residual is beyond its threshold
    calm: float  # for how long all of them have been small [s]
    touched: bool  # whether one has been beyond it since they were


class Task(Record, Protocol):
    """
    Where the operational frame is to be and how it is to move, world axes.

    There are two: `control.wanted`, that a source asks for, and `control.task`, within the limits.
    """

    position: Annotated[Vector, 3]  # x_des [m]

    # Desired axes of the operational frame as columns.
    rotation: Annotated[Matrix, 3, 3]

    twist: Annotated[Vector, 6]  # theta_des [m/s, rad/s]
    acceleration: Annotated[Vector, 6]  # a_des [m/s^2, rad/s^2]


class MotionObserverConfig(Record, Protocol):
    """What is set for the observer of what disturbs the motion."""

    # Of the twist's innovation, for the twist and for the disturbance [1/s]; 0 for no observer.
    twist_gain: float
    disturbance_gain: float

    delay: int  # T_d, from a sample to the torque that answers it [periods]

    # Of the way to the newest measured friction, per period; 0 for none that is fed forward.
    friction_share: float


class MotionObserver(Record, Protocol):
    """What disturbs the motion of the operational point, world axes; one."""

    config: MotionObserverConfig
    running: bool  # whether the law has answered the sample before
    twist_est: Annotated[Vector, 6]  # [m/s, rad/s]
    disturbance: Annotated[Vector, 6]  # p [m/s^2, rad/s^2]
    friction: Annotated[Vector, 6]  # of the contacts, low-passed [N, N m]

    # u of the newest ticks, the last one newest [m/s^2, rad/s^2].
    accelerations: Annotated[Matrix, MAX_DELAY_PERIODS + 1, 6]


class Control(Record, Protocol):
    """All that the control law works on besides joints, contacts and observers; one."""

    law: Law
    frame: Frame
    tool: Tool
    momentum: Momentum
    motion_observer: MotionObserver
    wanted: Task  # what the source of the task asks for

    # What the motion law is asked for: that, as far as contacts and limits allow.
    task: Task

    wrench: Annotated[Vector, 6]  # what the wrist sensor reads, in its frame [N, N m]
    measured: bool  # whether that is of this sample; if not, observers only predict


CONTROL = record_dtype(Control)


class ForceAnswer(Record, Protocol):
    """What the force law answers for one contact, all 0 where no law controls it."""

    active: bool  # whether its force is controlled
    alpha_des: float  # desired force [N]
    alpha_fed_forward: float  # force fed forward [N]

    # Estimated force and its rate [N], [N/s].
    alpha_est: float
    alpha_rate_est: float

    innovation: float  # alpha_meas - C x_1, 0 where nothing was predicted [N]
    prior_variance: float  # C P_1 C^T, 0 there as well [N^2]
    variance_used: float  # R the observer worked with, 0 there as well [N^2]


FORCE_ANSWER = record_dtype(ForceAnswer)


class ContactConfig(Record, Protocol):
    """
    What is configured of one column of N.

    A column is the normal force of a contact, or one of its couples.
    """

    kind: int  # FORCE, ALONG or ACROSS, see `config.contact`
    leader: int  # index of the normal force of the same contact

    # Unit normal INTO the surface, world axes; 0 for couples.
    normal: Annotated[Vector, 3]

    # Contact point, or centre, in the operational frame [m].
    point: Annotated[Vector, 3]

    # Of an edge, or of a plane's first side, in the operational frame.
    direction: Annotated[Vector, 3]

    half_length: float  # unit of a couple's lever, 0 for a force [m]
    friction_std: float  # of friction that is allowed for, 0 for couples [N]
    torsion_std: float  # of its torque about the normal [N m]
    friction_coefficient: float  # that is expected while sliding, 0 for couples
    normal_gain: float  # share of the way that the estimated normal goes per period

    # How far it goes per period at most, 0 where it is not estimated [rad].
    turn_limit: float

    smallest_cosine: float  # of the angle between it and the one configured

    # Axis of the tool that turns towards the estimated normal, in the operational frame, and by
    # how much at most [rad].
    tool_axis: Annotated[Vector, 3]
    tool_turn_limit: float

    surface_speed: float  # of the surface along its normal [m/s]
    surface_gain: float  # share of the way that its estimate goes per period
    surface_speed_limit: float  # bound of that, 0 where it is not estimated [m/s]


class Contact(Record, Protocol):
    """
    One column of N: what is configured, measured and learnt, and answered.

    Couples are in newtons, as a force at their end.
    """

    config: ContactConfig
    N: Annotated[Vector, 6]  # column of N: the wrench of a unit force, world axes
    alpha_meas: float  # measured force, without `untared` [N]
    untared: float  # what was read in free space, before a touch [N]
    speed_bound: float  # into a surface that has not answered, 0 for none [m/s]

    # What such a surface was found to bear, as an acceleration [m/s^2].
    borne_acceleration: float

    noise_variance: float  # R_k [N^2]

    # Whether the measured force is fed forward, as the surface seems to be gone.
    use_measured_force: bool

    normal: Annotated[Vector, 3]  # estimated unit normal, world axes
    surface_speed_est: float  # what is added to the configured speed, estimated [m/s]
    friction: Annotated[Vector, 3]  # found, world axes [N]
    stiffness: float  # k of the model in use [N/m]
    mobility: float  # N^T Lambda^-1 N of the newest answer, 0 before the first [1/kg]

    # Estimate of k, 0 for none; its error [N/m].
    stiffness_est: float
    stiffness_std: float

    ratio_bound: float  # largest likely true stiffness over that of the model in use
    margin: float  # largest ratio at which the force loop is stable, over that one
    wanted: bool  # whether the source of the task asks for it
    sought: bool  # whether the arm is on its way to the surface, or back from it
    alpha_wanted: float  # force that it asks for [N]
    answer: ForceAnswer


CONTACT = record_dtype(Contact)


class Input(Record, Protocol):
    """
    What has come in at a tick, as Python writes it; one.

    What of it is valid, and where it goes, is in `supervision.inputs`.
    """

    time: float  # of the tick, NaN if it is not a number [s]

    # Whether what is asked for is there and has the right shape: FINE, ABSENT or
    # INVALID, of `supervision.inputs`. Joint states may come without velocities and
    # without efforts.
    joints_came: int
    velocity_came: int
    effort_came: int

    wrench_came: int
    variance_came: int
    command_came: bool  # whether there is one of the tick before

    # When it was sampled [s].
    joints_stamp: float
    wrench_stamp: float
    variance_stamp: float

    # [rad], [rad/s].
    q: Annotated[Vector, MAX_JOINTS]
    velocity: Annotated[Vector, MAX_JOINTS]

    # Torques measured over the period before [N m].
    effort: Annotated[Vector, MAX_JOINTS]

    command: Annotated[Vector, MAX_JOINTS]  # torques commanded at the tick before [N m]
    wrench: Annotated[Vector, 6]  # what the wrist sensor reads, in its frame [N, N m]
    variance: Annotated[Vector, MAX_COLUMNS]  # R of each column of N [N^2]


INPUT = record_dtype(Input)
