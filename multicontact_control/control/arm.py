"""Where the arm is, what its model says there, and the torques that this leaves unexplained."""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import (
    add_vector,
    cross,
    dot,
    multiply_vector,
    rotate_vector,
    solve_lower,
    vector_between,
    velocity_at,
)
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.contact.wrench import (
    ContactSpace,
    measure_contacts,
    operational_wrench,
)
from multicontact_control.dynamics.operational_space import (
    compute_mobility_and_inertia,
    InertiaSpace,
)
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.dynamics.terms import ModelTerms
from multicontact_control.flags import (
    FORCES_AMBIGUOUS,
    JOINT_SPEED,
    MODEL_NOT_FINITE,
    OPERATIONAL_SPEED,
    RESIDUAL_CLEARED,
    RESIDUAL_EXCEEDED,
)
from multicontact_control.records import (
    Contact,
    Control,
    Frame,
    JOINT,
    Joint,
    MAX_JOINTS,
    Momentum,
    Record,
    record_dtype,
    Records,
)
import numpy as np

RELEASE = 0.5  # share of its threshold that a residual must fall below to count no more
# What a residual may follow: tanh(v / v_0), v [rad/s], dv/dt [rad/s^2], J_i^T f [N m].
REGRESSORS = DIRECTION, SPEED, ACCELERATION, WRENCH = range(4)
FADING_TIME = 1.0  # s, time constant of the sums over them
REST_TIME = 0.2  # s at rest, after which the residual at rest is known
LEARNING_TIME = 0.5  # s in motion, after which the friction is known
PRIOR_TIME = 0.01  # s of motion without friction that each joint has behind it
CALM_SHARE = 0.25  # of its threshold: a residual below is small
CALM_TIME = 0.1  # s for which all residuals are small once a touch is over
UNPROVEN_THRESHOLD = 3.0  # N m, least threshold of a joint that has moved for less


class ArmSpace(Record, Protocol):
    """What `update_arm_state` works in; one."""

    # Of the tool on the arm, or that the residual stands for [N, N m].
    wrench: Annotated[Vector, 6]

    felt: Annotated[Vector, MAX_JOINTS]  # J^T f [N m]
    inertial: Annotated[Vector, MAX_JOINTS]  # M dv/dt [N m]

    # L^-1 r, and of the operational point.
    reduced: Annotated[Vector, MAX_JOINTS]
    acceleration: Annotated[Vector, 6]

    inertia: InertiaSpace
    contacts: ContactSpace


ARM_SPACE = record_dtype(ArmSpace)


@compiled
def observe_momentum(
    control: Control,
    joints: Records[Joint],
    mass_matrix: Matrix,
    jacobian: Matrix,
    space: ArmSpace,
) -> bool:
    """
    Update the residual of every joint; return whether one is beyond its threshold.

    dr/dt = K (Gamma - M dv/dt - C v - g - F_c tanh(v / v_0) - F_v v - J^T f - r), the
    generalised-momentum observer, one sample at a time. f is the wrench at the wrist sensor (0
    where the residual is the input), so that r is J_i^T f_i of the contacts before it. They count
    from the threshold of a residual until it falls below half of that. The residual of a joint
    that is `unwatched`, as its torque is not known, stays. `control.momentum` and `joints` are
    changed.
    """
    momentum = control.momentum
    frame = control.frame
    tool = control.tool
    elapsed = momentum.elapsed
    wrench = space.wrench
    n = joints.shape[0]
    to_com = rotate_vector(frame.sensor_rotation, tool.com_sensor)
    to_sensor = vector_between(frame.position, frame.sensor_position)
    lever = to_com[0] + to_sensor[0], to_com[1] + to_sensor[1], to_com[2] + to_sensor[2]
    com_velocity = velocity_at(frame.twist, lever)
    if elapsed > 0.0:
        wrench[:] = 0.0
        if not momentum.config.is_input:
            operational_wrench(control, wrench)
            # Of what the sensor feels, the arm's model has the tool's inertia already.
            change = vector_between(momentum.com_velocity, com_velocity)
            inertial_force = (
                -tool.mass * change[0] / elapsed,
                -tool.mass * change[1] / elapsed,
                -tool.mass * change[2] / elapsed,
            )
            add_vector(wrench[:3], inertial_force)
            add_vector(wrench[3:], cross(lever, inertial_force))
        for i in range(n):
            space.felt[i] = dot(jacobian[:, i], wrench)
            space.inertial[i] = 0.0
            for j in range(n):
                space.inertial[i] += mass_matrix[min(i, j), max(i, j)] * (
                    joints[j].velocity - joints[j].watch.previous_velocity
                )
            space.inertial[i] /= elapsed
        share = 1.0 - np.exp(-momentum.config.bandwidth * elapsed)
        release = 1.0
        if momentum.collided:
            release = RELEASE
        exceeded = False
        for i in range(n):
            watch = joints[i].watch
            update_residual(control, joints[i], share, space.inertial[i], space.felt[i])
            limit = watch.threshold + watch.dynamic_threshold
            exceeded = exceeded or abs(watch.residual) > release * limit
        momentum.collided = exceeded
    momentum.com_velocity[:] = com_velocity
    return bool(momentum.collided)


@compiled
def update_residual(
    control: Control,
    joint: Joint,
    share: float,
    inertial: float,
    felt: float,
) -> None:
    """
    Let the residual of a joint follow the torque that nothing explains, by a share of the way.

    `inertial` is its element of M dv/dt, `felt` that of J^T f [N m]. A torque that is unknown or
    no number changes nothing, so that the other joints go on.
    """
    momentum = control.momentum
    watch = joint.watch
    direction = np.tanh(joint.velocity / control.law.friction_speed)
    unexplained = (
        watch.effort
        - inertial
        - (0.5 * (joint.bias_torque + watch.previous_bias_torque))
    )
    unexplained -= joint.config.coulomb * direction
    unexplained -= joint.config.viscous * joint.velocity
    unexplained -= felt
    if watch.unwatched or not np.isfinite(unexplained):
        return
    watch.residual += share * (unexplained - watch.residual)
    dynamic_share = momentum.config.dynamic_share
    watch.dynamic_threshold += share * (
        dynamic_share * abs(inertial)
        + watch.effort_uncertainty
        - watch.dynamic_threshold
    )
    acceleration = (joint.velocity - watch.previous_velocity) / momentum.elapsed
    learn_friction(momentum, joint, share, direction, acceleration, felt)


@compiled
def learn_friction(
    momentum: Momentum,
    joint: Joint,
    share: float,
    direction: float,
    acceleration: float,
    felt: float,
) -> None:
    """
    Sum up what the residual of a joint follows (`REGRESSORS`), and set its threshold.

    The mean of the residual along the first motion of a joint, beyond that at rest, is friction
    that is not compensated, and raises the threshold, less a standard deviation.
    """
    elapsed = momentum.elapsed
    watch = joint.watch
    statistics = watch.residual_statistics
    moving = direction**2 * elapsed  # of the time that elapsed [s]
    if statistics.time_at_rest < REST_TIME:
        statistics.time_at_rest += elapsed
        statistics.residual_at_rest += (
            (elapsed - moving)
            / statistics.time_at_rest
            * (watch.residual - statistics.residual_at_rest)
        )
    beyond = watch.residual - statistics.residual_at_rest
    fading = np.exp(-elapsed / FADING_TIME)
    statistics.residual_power = fading * statistics.residual_power + elapsed * beyond**2
    for k, newest in enumerate((direction, joint.velocity, acceleration, felt)):
        value = statistics.regressor[k] + share * (newest - statistics.regressor[k])
        statistics.regressor[k] = value
        power = statistics.regressor_power[k]
        statistics.regressor_power[k] = fading * power + elapsed * value * value
        correlation = statistics.correlation[k]
        statistics.correlation[k] = fading * correlation + elapsed * value * beyond
    if statistics.time_in_motion < LEARNING_TIME and not momentum.collided:
        statistics.time_in_motion += moving
        weight = moving / (statistics.time_in_motion + PRIOR_TIME)
        along_motion = beyond * np.sign(direction)
        statistics.friction += weight * (along_motion - statistics.friction)
        statistics.mean_square += weight * (beyond**2 - statistics.mean_square)
    config = joint.config
    if config.learnt_friction_limit > 0.0:
        least = config.least_threshold
        if statistics.time_in_motion < LEARNING_TIME:
            least = max(least, min(UNPROVEN_THRESHOLD, config.learnt_friction_limit))
        # Of what touches the arm, which grows, the deviation is near the mean.
        variance = max(statistics.mean_square - statistics.friction**2, 0.0)
        learnt = statistics.friction - np.sqrt(variance)
        if learnt > config.learnt_friction_limit:
            learnt = config.learnt_friction_limit
        friction = config.declared_friction
        if learnt > friction:  # which no number, as after an impossible effort, is not
            friction = learnt
        watch.threshold = least + friction


@compiled
def detect_passed_touch(momentum: Momentum, joints: Records[Joint]) -> bool:
    """
    Sum up the residuals until the arm is calm; return whether one that was a touch has passed.

    What is summed up stays for that tick, and begins anew at the next one.
    """
    calm = True
    for i in range(joints.shape[0]):
        watch = joints[i].watch
        statistics = watch.residual_statistics
        beyond = watch.residual - statistics.residual_at_rest
        statistics.residual_integral += momentum.elapsed * beyond
        calm = calm and abs(beyond) < CALM_SHARE * watch.threshold
    momentum.touched = momentum.touched or momentum.collided
    if not calm:
        momentum.calm = 0.0
        return False
    momentum.calm += momentum.elapsed
    if momentum.calm < CALM_TIME:
        return False
    if momentum.touched:
        momentum.touched = False
        return True
    for i in range(joints.shape[0]):
        statistics = joints[i].watch.residual_statistics
        statistics.residual_integral = 0.0
        statistics.calm_wrench_torque = statistics.regressor[WRENCH]
    return False


@compiled
def fill_wrench_of_residual(
    control: Control,
    joints: Records[Joint],
    mass_matrix: Matrix,
    jacobian: Matrix,
    space: ArmSpace,
) -> None:
    """
    Fill in the wrench that explains the residual, as a sensor at the operational point reads it.

    f = J_bar^T r, J_bar = M^-1 J^T Lambda. In a singular posture `control.wrench` stays as it was.
    """
    n = joints.shape[0]
    inertia = space.inertia
    rotation = control.frame.sensor_rotation
    damping, _ = compute_mobility_and_inertia(
        mass_matrix, jacobian, control.law.singular_mobility, inertia
    )
    if damping < 0.0:
        return
    reduced = space.reduced[:n]
    for i in range(n):
        reduced[i] = joints[i].watch.residual
    solve_lower(inertia.L[:n, :n], reduced)
    multiply_vector(inertia.Y[:n].T, reduced, space.acceleration)
    multiply_vector(inertia.Lambda, space.acceleration, space.wrench)
    control.wrench[:3] = rotate_vector(rotation.T, space.wrench[:3])
    control.wrench[3:] = rotate_vector(rotation.T, space.wrench[3:])


@compiled
def update_arm_state(
    motion: Matrix,
    terms: ModelTerms,
    joints: Records[Joint],
    control: Control,
    contacts: Records[Contact],
    space: ArmSpace,
) -> int:
    """
    Take in all that is known of a sample before anything is asked for.

    Parameters
    ----------
    motion
        Joint positions [rad] and velocities [rad/s], shape (2, n).
    terms
        Of the arm's model there.
    joints, control, contacts
        Records of `JOINT`, shape (n,), one of `CONTROL` with the wrench in it, and records of
        `CONTACT`, shape (r,); all changed.
    space
        A record of `ARM_SPACE`.

    Returns
    -------
    int
        The sum of MODEL_NOT_FINITE, OPERATIONAL_SPEED, JOINT_SPEED, FORCES_AMBIGUOUS,
        RESIDUAL_EXCEEDED and RESIDUAL_CLEARED.

    """
    q = motion[0]
    velocity = motion[1]
    mass_matrix = terms.mass_matrix
    jacobian = terms.jacobian
    frame = control.frame
    flags = 0
    for j in range(joints.shape[0]):
        if not np.isfinite(terms.bias_torque[j]):
            return MODEL_NOT_FINITE
    for j in range(joints.shape[0]):
        joint = joints[j]
        joint.watch.previous_velocity = joint.velocity
        joint.watch.previous_bias_torque = joint.bias_torque
        joint.q = q[j]
        joint.velocity = velocity[j]
        joint.inertia = mass_matrix[j, j]
        joint.bias_torque = terms.bias_torque[j]
        if abs(joint.velocity) > joint.config.speed_limit:
            flags = JOINT_SPEED
    frame.position[:] = terms.position
    frame.rotation[:] = terms.rotation
    frame.sensor_position[:] = terms.sensor_position
    frame.sensor_rotation[:] = terms.sensor_rotation
    multiply_vector(jacobian, velocity, frame.twist)
    velocity_squared = dot(frame.twist[:3], frame.twist[:3])
    turn_squared = dot(frame.twist[3:], frame.twist[3:])
    too_fast = velocity_squared > frame.config.speed_limit**2
    if too_fast or turn_squared > frame.config.turn_limit**2:
        flags |= OPERATIONAL_SPEED
    if control.momentum.config.bandwidth > 0.0:
        if observe_momentum(control, joints, mass_matrix, jacobian, space):
            flags |= RESIDUAL_EXCEEDED
        if detect_passed_touch(control.momentum, joints):
            flags |= RESIDUAL_CLEARED
        if control.momentum.config.is_input:
            fill_wrench_of_residual(control, joints, mass_matrix, jacobian, space)
    if not measure_contacts(control, contacts, space.contacts):
        flags |= FORCES_AMBIGUOUS
    return flags


class ArmState:
    """
    The arm when its joints were last given, in arrays that the next sample overwrites.

    Parameters
    ----------
    robot
        Its model, an attribute as well.
    controls, contacts
        One record of `CONTROL` and records of `CONTACT`, shape (r,), to be filled in;
        attributes as well.

    Attributes
    ----------
    motion, q, velocity
        Joint positions and velocities, shape (2, n) [rad, rad/s], and its rows.
    joints, frames
        Records of `JOINT`, shape (n,), and one of `FRAME`.
    inertia, bias_torque
        Diagonal of M [kg m^2] and C v + g [N m], in `joints`, shape (n,).
    pose
        Of the operational frame, in `frames`.
    flags
        What the newest sample was found to have; see `multicontact_control.flags`.

    """

    def __init__(
        self,
        robot: RobotModel,
        controls: Records[Control],
        contacts: Records[Contact],
    ) -> None:
        self.robot = robot
        self.motion: Matrix = np.zeros((2, robot.joint_count))
        self.q, self.velocity = self.motion
        self.joints: Records[Joint] = np.zeros(robot.joint_count, dtype=JOINT)
        self.controls = controls
        self.contacts = contacts
        self.frames: Records[Frame] = controls['frame']
        self.joints['config']['speed_limit'] = np.inf
        self.frames['config']['speed_limit'] = np.inf
        self.frames['config']['turn_limit'] = np.inf
        self.inertia: Vector = self.joints['inertia']
        self.bias_torque: Vector = self.joints['bias_torque']
        self._space: ArmSpace = np.zeros(1, dtype=ARM_SPACE)[0]
        self.pose = Pose(self.frames['position'][0], self.frames['rotation'][0])
        self.take_motion()

    @property
    def has_finite_terms(self) -> bool:
        """Whether the model gave finite numbers; if not, the arm is where it was before."""
        return not self.flags & MODEL_NOT_FINITE

    def take_motion(self) -> bool:
        """Take in what has been written into `motion`; return whether the model stays finite."""
        self.robot.compute(self.q, self.velocity)
        self.flags = update_arm_state(
            self.motion,
            self.robot.terms,
            self.joints,
            self.controls[0],
            self.contacts,
            self._space,
        )
        return self.has_finite_terms
