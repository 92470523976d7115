"""
The composed control law, compiled.

Two calls make a tick: `measure_contacts`, after which the reference is asked what to do, and
`control_law`. Whatever they fill has been allocated before; contacts are handled in arrays of
fixed size with a mask.
"""

from __future__ import annotations

from multicontact_control.algebra import cross, multiply, multiply_transposed
from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.contact.kernels import (
    allocate,
    compose_acceleration,
    coordinates,
    factorise_contacts,
    keep_active,
    normal_rows,
    rates,
)
from multicontact_control.dynamics.kernels import (
    add_nullspace_torque,
    bias_acceleration,
    mobility_and_inertia,
    rotation_vector,
)
from multicontact_control.force.kernels import ESTIMATED, MEASURED, observe_and_command
import numpy as np

# What `control_law` returns.
OK, SINGULAR, DEPENDENT = range(3)
# Entries of `gains`: k_p, k_v, K_2, friction speed, null-space damping, largest condition,
# eigenvalue up to which Lambda^-1 is damped.
K_P, K_V, K_2, FRICTION_SPEED, NULLSPACE_DAMPING, MAX_CONDITION, SINGULAR_MOBILITY = range(7)
# Rows of `joints`.
COULOMB, VISCOUS, TORQUE_LIMIT = range(3)
# Row of `pose_des` below the axes, and rows of `motion_des`.
POSITION = 3
TWIST, ACCELERATION = range(2)
# Rows of `tool`.
COM_SENSOR, WEIGHT, FORCE_BIAS, TORQUE_BIAS = range(4)


@compiled
def operational_wrench(
    wrench_sensor: Vector, sensor_rotation: Matrix, sensor_position: Vector, position: Vector,
    tool: Matrix, wrench: Vector,
) -> None:
    """
    Fill in the wrench the robot exerts on the environment, at the operational point.

    The sensor reads m (a - g) + f_c + bias; see `contact_wrench` for what becomes of it.

    Parameters
    ----------
    wrench_sensor
        Reading, sensor axes and origin, shape (6,) [N, N m].
    sensor_rotation, sensor_position, position
        Pose of the sensor and the operational point, world axes [m].
    tool
        Centre of mass in the sensor frame [m], weight m g in world axes [N], and the sensor's
        bias of force [N] and torque [N m] in its frame, shape (4, 3).
    wrench
        Filled, world axes, shape (6,).

    """
    weight = tool[WEIGHT]
    com = np.empty(3)
    lever = np.empty(3)
    moment = np.empty(3)
    for i in range(3):
        com[i] = 0.0
        wrench[i] = weight[i]
        wrench[3 + i] = 0.0
        lever[i] = sensor_position[i] - position[i]
        for j in range(3):
            com[i] += sensor_rotation[i, j] * tool[COM_SENSOR, j]
            force = wrench_sensor[j] - tool[FORCE_BIAS, j]
            torque = wrench_sensor[3 + j] - tool[TORQUE_BIAS, j]
            wrench[i] += sensor_rotation[i, j] * force
            wrench[3 + i] += sensor_rotation[i, j] * torque
    cross(com, weight, moment)
    for i in range(3):
        wrench[3 + i] += moment[i]
    cross(lever, wrench, moment)
    for i in range(3):
        wrench[3 + i] += moment[i]


@compiled
def measure_contacts(
    report: Matrix, wrench_sensor: Vector, sensor_rotation: Matrix, sensor_position: Vector,
    rotation: Matrix, position: Vector, tool: Matrix, normals: Matrix, points: Matrix,
    measured: Mask, rows: Matrix,
) -> bool:
    """
    Work out the contact forces that the wrist sensor feels.

    alpha = (N^T N)^-1 N^T f_c (P04 eqs 2, 5, 7).

    Parameters
    ----------
    report
        Its row MEASURED is filled, 0 for a contact that is not measured, shape (7, r) [N].
    wrench_sensor, sensor_rotation, sensor_position, position, tool
        As for `operational_wrench`.
    rotation
        Axes of the operational frame.
    normals, points
        Contact normals in world axes and points in the operational frame, shape (r, 3).
    measured
        Which contacts share the wrench among them, at most six, shape (r,).
    rows
        Filled with N^T, shape (r, 6).

    Returns
    -------
    bool
        Whether the measured columns of N are independent.

    """
    count = normals.shape[0]
    wrench = np.empty(6)
    operational_wrench(
        wrench_sensor, sensor_rotation, sensor_position, position, tool, wrench)
    normal_rows(normals, points, rotation, rows)
    kept = np.empty((count, 6))
    factor = np.empty((count, count))
    keep_active(rows, measured, kept)
    if not factorise_contacts(kept, kept, measured, factor):
        return False
    coordinates(kept, factor, wrench, report[MEASURED])
    return True


@compiled
def motion_law(
    gains: Vector, pose_des: Matrix, motion_des: Matrix, position: Vector, rotation: Matrix,
    twist: Vector, f_t: Vector,
) -> None:
    """
    Fill in f_t* = a_des + k_v (theta_des - theta) + k_p (x_des - x) (P04 sec. 3.1).

    Parameters
    ----------
    gains
        K_P and K_V of it are used.
    pose_des
        Desired axes as columns, and below them the desired position, world axes, shape (4, 3).
    motion_des
        Desired twist and acceleration, world axes, shape (2, 6).
    position, rotation, twist
        Present motion.
    f_t
        Filled, shape (6,) [m/s^2, rad/s^2].

    """
    turn = np.empty(3)
    rotation_vector(pose_des, rotation, turn)
    for i in range(3):
        f_t[i] = gains[K_P] * (pose_des[POSITION, i] - position[i])
        f_t[3 + i] = gains[K_P] * turn[i]
    for i in range(6):
        f_t[i] += motion_des[ACCELERATION, i] + gains[K_V] * (motion_des[TWIST, i] - twist[i])


@compiled
def force_law(
    gains: Vector, decoupled: bool, rows: Matrix, factor: Matrix, twist: Vector, inputs: Vector,
    f_c: Vector,
) -> None:
    """
    Fill in f_c*, the acceleration that serves the force loops with damping K_2 (P04 eq. 30).

    Parameters
    ----------
    gains
        K_2 of it is used.
    decoupled
        See `allocate`; the damping acts along the same coordinates.
    rows, factor
        N^T of the active contacts and the factor of N^T N.
    twist
        Of the operational point, shape (6,).
    inputs
        u of the observers, shape (r,) [m/s^2].
    f_c
        Filled, shape (6,) [m/s^2, rad/s^2].

    """
    alpha_star = np.empty(inputs.shape[0])
    if decoupled:
        rates(rows, twist, alpha_star)
    else:
        coordinates(rows, factor, twist, alpha_star)
    for i in range(inputs.shape[0]):
        alpha_star[i] = inputs[i] - gains[K_2] * alpha_star[i]
    allocate(rows, factor, alpha_star, decoupled, f_c)


@compiled
def finish_torque(gains: Vector, joints: Matrix, velocity: Vector, torque: Vector) -> None:
    """
    Add the friction that the joints are expected to take, then keep to the limits.

    Gamma += F_c tanh(v / v_0) + F_v v.

    Parameters
    ----------
    gains, joints
        Friction speed v_0; Coulomb F_c, viscous F_v and limit per joint, shape (3, n).
    velocity
        v, shape (n,) [rad/s].
    torque
        Gamma, changed in place, shape (n,) [N m].

    """
    for j in range(torque.shape[0]):
        if joints[COULOMB, j] != 0.0:
            torque[j] += joints[COULOMB, j] * np.tanh(velocity[j] / gains[FRICTION_SPEED])
        torque[j] += joints[VISCOUS, j] * velocity[j]
        limit = joints[TORQUE_LIMIT, j]
        if torque[j] > limit:  # written so that what is not a number stays that
            torque[j] = limit
        elif torque[j] < -limit:
            torque[j] = -limit


@compiled
def span_contacts(
    all_rows: Matrix, active: Mask, mobility: Matrix, inertia_metric: bool, rows: Matrix,
    factor: Matrix, weighted_rows: Matrix, weighted_factor: Matrix,
) -> bool:
    """
    Work out what the active contacts span, and in which metric motion is kept off it.

    Parameters
    ----------
    all_rows, active
        N^T of all contacts, shape (r, 6), and which of them are force controlled, shape (r,).
    mobility
        Lambda^-1, shape (6, 6).
    inertia_metric
        Whether the dual of N is Lambda^-1 N, otherwise N itself.
    rows, factor
        Filled: N^T with zeros where not active, and its factor; see `factorise_contacts`.
    weighted_rows, weighted_factor
        The same in that metric; `rows` and `factor` themselves if it is that of the identity.

    Returns
    -------
    bool
        Whether the active contacts are independent.

    """
    keep_active(all_rows, active, rows)
    if not factorise_contacts(rows, rows, active, factor):
        return False
    if not inertia_metric:
        return True
    for i in range(rows.shape[0]):
        multiply(mobility, rows[i], weighted_rows[i])
    return factorise_contacts(rows, weighted_rows, active, weighted_factor)


@compiled
def control_law(
    report: Matrix, torque: Vector, jacobian: Matrix, jacobian_rate: Matrix,
    mass_matrix: Matrix, bias_torque: Vector, velocity: Vector, position: Vector,
    rotation: Matrix, pose_des: Matrix, motion_des: Matrix, all_rows: Matrix, active: Mask,
    alpha_des: Vector, noise_variance: Vector, gains: Vector, inertia_metric: bool,
    decoupled: bool, joints: Matrix, matrices: Matrix, vectors: Matrix, scalars: Matrix,
    P_0: float,
) -> int:
    """
    Work out the joint torque of one tick.

    F = Lambda (Omega_m f_t* + Omega_c f_c*) + mu + p + N alpha_est, Gamma = J^T F (P04
    eqs 23-27), then null space, friction and limits.

    Parameters
    ----------
    report
        What was measured is there; the rest is filled in, see `observe_and_command`.
    torque
        Filled, shape (n,) [N m].
    jacobian, jacobian_rate, mass_matrix, bias_torque, velocity
        J, dJ/dt, M (upper triangle), C v + g and v.
    position, rotation
        Pose of the operational frame.
    pose_des, motion_des
        Reference; see `motion_law`.
    all_rows
        N^T of all contacts, shape (r, 6).
    active, alpha_des, noise_variance
        Which contacts are force controlled, desired forces, R; shape (r,).
    gains, inertia_metric, decoupled, joints
        Options; see the constants of this module, `compose_acceleration` and `allocate`.
    matrices, vectors, scalars, P_0
        Observers; see `ObserverBank`.

    Returns
    -------
    int
        OK, or what is wrong; the observers have not been touched then.

    """
    n = velocity.shape[0]
    count = all_rows.shape[0]
    L = np.empty((n, n))
    Y = np.empty((n, 6))
    mobility = np.empty((6, 6))
    Lambda = np.empty((6, 6))
    damping = mobility_and_inertia(
        mass_matrix, jacobian, gains[MAX_CONDITION], gains[SINGULAR_MOBILITY], L, Y, mobility,
        Lambda)
    if damping < 0.0:
        return SINGULAR
    rows = np.empty((count, 6))
    factor = np.empty((count, count))
    weighted_rows = np.empty((count, 6)) if inertia_metric else rows
    weighted_factor = np.empty((count, count)) if inertia_metric else factor
    if not span_contacts(all_rows, active, mobility, inertia_metric, rows, factor, weighted_rows,
                         weighted_factor):
        return DEPENDENT
    twist = np.empty(6)
    f_t = np.empty(6)
    f_c = np.empty(6)
    acceleration = np.empty(6)
    bias = np.empty(6)
    force = np.empty(6)
    inputs = np.empty(count)
    multiply(jacobian, velocity, twist)
    motion_law(gains, pose_des, motion_des, position, rotation, twist, f_t)
    observe_and_command(
        matrices, vectors, scalars, P_0, active, alpha_des, noise_variance, report, inputs)
    force_law(gains, decoupled, rows, factor, twist, inputs, f_c)
    compose_acceleration(rows, weighted_rows, weighted_factor, f_t, f_c, acceleration)
    bias_acceleration(L, Y, bias_torque, jacobian_rate, velocity, bias)
    for i in range(6):
        acceleration[i] += bias[i]
    multiply(Lambda, acceleration, force)
    for i in range(count):
        for k in range(6):
            force[k] += rows[i, k] * report[ESTIMATED, i]
    multiply_transposed(jacobian, force, torque)
    if n > 6 or damping > 0.0:
        add_nullspace_torque(mass_matrix, jacobian, L, Y, Lambda, bias_torque, velocity,
                             gains[NULLSPACE_DAMPING], torque)
    finish_torque(gains, joints, velocity, torque)
    return OK
