"""
Bounds on how fast the arm may come near a joint stop, a joint speed or a singular posture.

What comes near is braked by a bound on its acceleration, from its distance and its speed. The
accelerations that the torque leads to are brought within these bounds by the mass matrix, all
joints together: where one joint must stop, the others go on with what the task can still have. The
forces of the contacts come first, then position and orientation. These give way together, by
millimetres and hundredths of a radian, as the reference waits for an arm that cannot follow
(`contact_task`).
"""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import (
    add_scaled_vector,
    cholesky,
    dot,
    gram_matrix,
    multiply_vector,
    solve_cholesky,
    solve_lower_columns,
    vector_length,
)
from multicontact_control.arrays import Bytes, Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.contact.wrench import operational_wrench
from multicontact_control.dynamics.operational_space import (
    compute_mobility_gradient,
    diagonalise_mobility,
    InertiaSpace,
)
from multicontact_control.dynamics.terms import ModelTerms
from multicontact_control.flags import JOINT_BOUNDED, SINGULARITY_BOUNDED
from multicontact_control.records import (
    Contact,
    Control,
    Joint,
    MAX_JOINTS,
    Record,
    record_dtype,
    Records,
)
import numpy as np

SPEED_SHARE = 0.98  # of the speed limit of a joint, up to which it may go
SPEED_GAIN = 50.0  # 1/s, how fast a speed is brought back to the one that is allowed
STOP_RATE = 20.0  # 1/s, of the way left: the speed that is allowed near a stop
JOINT_BRAKING = 5.0  # rad/s^2 counted on farther away from it
STOP_ZONE = 0.1  # rad before a stop, where a joint is always looked after
# Of the speed that is allowed, from where on it is looked after elsewhere.
WATCHED_SHARE = 0.5
# sqrt(kg)^-1: square root of the smallest eigenvalue of Lambda^-1. Motion ends at the first, above
# which Lambda is not damped (0.004 1/kg), and is looked after below the second.
SINGULAR_ROOT = 0.08
NEAR_SINGULAR_ROOT = 0.24
REACH_RATE = 5.0  # 1/s, of the way that remains to it: the rate that is allowed
# What a change of the accelerations costs: of contact points along their normals, of the
# operational point, and of the joints in the metric of M. The orientation counts at a lever: what
# is asked for, a motion or a turn, gives way before what is to stay.
FORCE_COST = 1e4  # s^4/m^2
MOTION_COST = 1.0  # s^4/m^2
JOINT_COST = 1e-4  # 1/kg
MOVING_LEVER = 0.3  # m
TURNING_LEVER = 0.14  # m
MOST_EXCHANGES = 60  # of a bound that counts for one that does not
ROUNDING = 1e-12

MAX_BOUNDS = 2 * MAX_JOINTS + 6


class BoundSpace(Record, Protocol):
    """
    What `bound_motion` works in, so that nothing is allocated; one.

    Rows R and bounds b say R a <= b of the accelerations a; the least change x of these costs
    x^T H x, see `fill_change_cost`.
    """

    torque: Annotated[Vector, MAX_JOINTS]  # Gamma [N m]

    # See `add_joint_bounds`.
    rows: Annotated[Matrix, MAX_BOUNDS, MAX_JOINTS]
    bounds: Annotated[Vector, MAX_BOUNDS]

    # Of each bound [rad/s^2].
    excess: Annotated[Vector, MAX_BOUNDS]
    multipliers: Annotated[Vector, MAX_BOUNDS]

    # [rad/s^2].
    acceleration: Annotated[Vector, MAX_JOINTS]
    change: Annotated[Vector, MAX_JOINTS]

    rates: Annotated[Vector, MAX_JOINTS]
    wrench: Annotated[Vector, 6]  # that the contacts bear [N, N m]
    cost: Annotated[Matrix, MAX_JOINTS, MAX_JOINTS]
    row: Annotated[Vector, MAX_JOINTS]

    # See `solve_least_change`: H = root root^T, Z = root^-1 R^T, and G = Z^T Z.
    root: Annotated[Matrix, MAX_JOINTS, MAX_JOINTS]
    Z: Annotated[Matrix, MAX_JOINTS, MAX_BOUNDS]

    G: Annotated[Matrix, MAX_BOUNDS, MAX_BOUNDS]
    basis: Annotated[Matrix, MAX_BOUNDS, MAX_BOUNDS]

    factor: Annotated[Matrix, MAX_BOUNDS, MAX_BOUNDS]
    response: Annotated[Vector, MAX_BOUNDS]  # G y [rad/s^2]

    # 1 for a bound whose multiplier may be above 0.
    counts: Annotated[Bytes, MAX_BOUNDS]


BOUND_SPACE = record_dtype(BoundSpace)


@compiled
def allowed_stop_speed(distance: float) -> float:
    """
    Return how fast a joint may come near its stop, at a distance [rad], negative beyond it.

    v = k d near the stop, from which a joint beyond it returns, and sqrt(2 a (d - a / 2 k^2))
    farther away, as a = JOINT_BRAKING lets it stop; [rad/s].
    """
    linear = JOINT_BRAKING / STOP_RATE**2
    if distance <= linear:
        return STOP_RATE * distance
    return np.sqrt(2.0 * JOINT_BRAKING * (distance - 0.5 * linear))


@compiled
def add_joint_bounds(joints: Records[Joint], rows: Matrix, bounds: Vector) -> int:
    """
    Fill in a row for each side on which a joint is near its stop or its speed limit.

    `rows`, shape (count, n), times the accelerations must not exceed `bounds` [rad/s^2]: a speed v
    towards a limit, of which v_a is allowed, may rise by k (v_a - v) - s v, where v_a falls by s
    for each unit of the way. Returns how many rows were filled in.
    """
    count = 0
    for j in range(joints.shape[0]):
        joint, limit = joints[j], joints[j].gate
        fastest = SPEED_SHARE * joint.config.gate_speed
        for side in (1.0, -1.0):
            distance = joint.q - limit.lower
            if side > 0.0:
                distance = limit.upper - joint.q
            closing = side * joint.velocity
            allowed = min(allowed_stop_speed(distance), fastest)
            if not (distance < STOP_ZONE or closing > WATCHED_SHARE * allowed):
                continue
            slope = 0.0
            if allowed < fastest:
                slope = min(STOP_RATE, JOINT_BRAKING / max(allowed, ROUNDING))
            rows[count] = 0.0
            rows[count, j] = side
            bounds[count] = SPEED_GAIN * (allowed - closing) - slope * closing
            count += 1
    return count


@compiled
def add_reach_bounds(
    joints: Records[Joint],
    jacobian: Matrix,
    rows: Matrix,
    bounds: Vector,
    count: int,
    inertia: InertiaSpace,
    space: BoundSpace,
) -> int:
    """
    Fill in a row for each direction in which the arm is nearly singular, as stretched arms are.

    The distance is that of the square root of an eigenvalue of Lambda^-1 from `SINGULAR_ROOT`. A
    posture that is beyond it may be left, but not made worse. `inertia` is that of the law's
    answer; for the rest see `add_joint_bounds`.
    """
    n = joints.shape[0]
    diagonalise_mobility(inertia)
    for k in range(6):
        size = np.sqrt(max(inertia.eigenvalues[k, k], ROUNDING))
        if size > NEAR_SINGULAR_ROOT:
            continue
        gradient, closing = rows[count], 0.0
        compute_mobility_gradient(
            jacobian,
            inertia.L[:n, :n],
            inertia.Y[:n],
            inertia.directions[:, k],
            space.rates[:n],
            gradient,
        )
        # So that it closes in where this times the speeds is positive.
        for j in range(n):
            gradient[j] *= -0.5 / size
            closing += gradient[j] * joints[j].velocity
        allowed = REACH_RATE * max(size - SINGULAR_ROOT, 0.0)
        bounds[count] = SPEED_GAIN * (allowed - closing) - REACH_RATE * closing
        count += 1
    return count


@compiled
def fill_change_cost(
    terms: ModelTerms,
    contacts: Records[Contact],
    twist_des: Vector,
    by_task: bool,
    space: BoundSpace,
) -> None:
    """
    Fill in H, `cost` of `space`, shape (n, n): a change of the accelerations by x costs x^T H x.

    Without a task (`by_task`), of a reaction say, the metric is M alone: the joints that must stop
    are stopped, and the torques of the others stay. `twist_des` is theta_des of the task, shape
    (6,) [m/s, rad/s], `contacts` are records of `CONTACT`; of `terms` M and J are read.
    """
    mass_matrix = terms.mass_matrix
    n = mass_matrix.shape[0]
    row = space.row[:n]
    cost = space.cost[:n, :n]
    for i in range(n):
        for j in range(i, n):
            cost[i, j] = JOINT_COST * mass_matrix[i, j]
    if not by_task:
        return
    speed = vector_length(twist_des[:3])
    turn = MOVING_LEVER * vector_length(twist_des[3:])
    turning = turn / max(speed + turn, ROUNDING)
    turn_cost = (
        MOTION_COST * (MOVING_LEVER + (TURNING_LEVER - MOVING_LEVER) * turning) ** 2
    )
    for index in range(contacts.shape[0] + 6):
        if index < 6:
            row[:] = terms.jacobian[index]
            weight = MOTION_COST if index < 3 else turn_cost
        else:
            contact = contacts[index - 6]
            weight = FORCE_COST
            if not contact.answer.active:
                continue
            multiply_vector(terms.jacobian.T, contact.N, row)
        for i in range(n):
            for j in range(i, n):
                cost[i, j] += weight * row[i] * row[j]


@compiled
def solve_least_change(n: int, m: int, space: BoundSpace) -> bool:
    """
    Fill in the x of least x^T H x / 2 with R x <= -e; return whether it was found.

    x = -H^-1 R^T y with multipliers y >= 0, which are above 0 for bounds that count. They solve a
    linear complementarity problem of the matrix R H^-1 R^T, by exchanging the first bound that is
    wrong, which ends (Murty 1974).

    In `space`, a record of `BOUND_SPACE`, `cost` is H, upper triangle, shape (n, n), `rows` R,
    shape (m, n), `excess` e, shape (m,); `multipliers` y, shape (m,), and `change` x, shape (n,),
    are filled in.
    """
    rows, excess, change = space.rows[:m, :n], space.excess[:m], space.change[:n]
    multipliers, response = space.multipliers[:m], space.response[:m]
    root, Z, G = space.root[:n, :n], space.Z[:n, :m], space.G[:m, :m]
    basis, factor = space.basis[:m, :m], space.factor[:m, :m]
    counts = space.counts[:m]
    if not cholesky(space.cost[:n, :n], root, 0.0):
        return False
    Z[:] = rows.T
    solve_lower_columns(root, Z)
    gram_matrix(Z, G)
    counts[:] = 0
    for _ in range(MOST_EXCHANGES):
        for i in range(m):
            multipliers[i] = 0.0
            for j in range(m):
                basis[i, j] = 0.0
                if counts[i] and counts[j]:
                    basis[i, j] = G[i, j]
            basis[i, i] = 1.0
            if counts[i]:
                multipliers[i] = excess[i]
                basis[i, i] = G[i, i] * (1.0 + ROUNDING)
        if not cholesky(basis, factor, 0.0):
            return False
        solve_cholesky(factor, multipliers)
        multiply_vector(G, multipliers, response)
        wrong = _find_wrong_bound(counts, multipliers, response, excess)
        if wrong < 0:
            for j in range(n):
                change[j] = -dot(rows[:, j], multipliers)
            solve_cholesky(root, change)
            return True
        counts[wrong] = 1 - counts[wrong]
    return False


@compiled
def _find_wrong_bound(
    counts: Bytes, multipliers: Vector, response: Vector, excess: Vector
) -> int:
    """Return the first bound that counts and pulls, or is passed and does not count; or -1."""
    for i in range(excess.shape[0]):
        if counts[i]:
            wrong = multipliers[i] < 0.0
        else:
            tolerance = ROUNDING * (1.0 + abs(excess[i]))
            wrong = response[i] - excess[i] < -tolerance
        if wrong:
            return i
    return -1


@compiled
def predict_acceleration(
    control: Control,
    joints: Records[Joint],
    contacts: Records[Contact],
    jacobian: Matrix,
    L: Matrix,
    space: BoundSpace,
) -> None:
    """
    Fill in M^-1 (Gamma - C v - g - friction - J^T f), shape (n,) [rad/s^2].

    f is the measured wrench of the contacts, or what is fed forward to them where there is none.
    M = L L^T, and `space` is a record of `BOUND_SPACE`, with Gamma in it.
    """
    n, wrench = joints.shape[0], space.wrench
    acceleration = space.acceleration[:n]
    wrench[:] = 0.0
    if control.measured:
        operational_wrench(control, wrench)
    else:
        for i in range(contacts.shape[0]):
            add_scaled_vector(
                wrench, contacts[i].answer.alpha_fed_forward, contacts[i].N
            )
    for j in range(n):
        joint = joints[j]
        friction = (
            joint.config.viscous * joint.velocity
            + joint.config.coulomb
            * np.tanh(joint.velocity / control.law.friction_speed)
        )
        acceleration[j] = space.torque[j] - joint.bias_torque - friction
        for i in range(6):
            acceleration[j] -= jacobian[i, j] * wrench[i]
    solve_cholesky(L, acceleration)


@compiled
def bound_motion(
    joints: Records[Joint],
    control: Control,
    contacts: Records[Contact],
    terms: ModelTerms,
    by_task: bool,
    inertia: InertiaSpace,
    space: BoundSpace,
) -> int:
    """
    Change a torque so that no bound of the motion is passed; return which ones were.

    Parameters
    ----------
    joints, control, contacts
        Records of `JOINT`, shape (n,), one of `CONTROL`, and records of `CONTACT`, shape (r,).
    terms
        Of the arm's model: M and J are read.
    by_task
        Whether the torque serves contacts and a task, which are kept as far as possible. It is
        then the law's, which has filled in `inertia`; else that is filled in here.
    inertia
        A record of `INERTIA_SPACE`.
    space
        A record of `BOUND_SPACE`, whose `torque` is changed by M x, x the least change of
        accelerations that serves.

    Returns
    -------
    int
        The sum of JOINT_BOUNDED (also of its speed limit) and SINGULARITY_BOUNDED.

    """
    n = joints.shape[0]
    mass_matrix = terms.mass_matrix
    rows = space.rows[:, :n]
    bounds = space.bounds
    stops = add_joint_bounds(joints, rows, bounds)
    count = stops
    nearly_singular = by_task and control.frame.mobility < NEAR_SINGULAR_ROOT**2
    if count == 0 and not nearly_singular:
        return 0
    L = inertia.L[:n, :n]
    if not by_task and not cholesky(mass_matrix, L, 0.0):
        return 0
    if nearly_singular:
        count = add_reach_bounds(
            joints, terms.jacobian, rows, bounds, count, inertia, space
        )
    predict_acceleration(control, joints, contacts, terms.jacobian, L, space)
    exceeded = False
    for i in range(count):
        space.excess[i] = dot(rows[i], space.acceleration[:n]) - bounds[i]
        exceeded = exceeded or space.excess[i] > 0.0
    if not exceeded:
        return 0
    fill_change_cost(terms, contacts, control.task.twist, by_task, space)
    if not solve_least_change(n, count, space):
        return 0
    for i in range(n):
        for j in range(n):
            space.torque[i] += mass_matrix[min(i, j), max(i, j)] * space.change[j]
    enforced = 0
    for i in range(count):
        if space.multipliers[i] > 0.0:
            if i < stops:
                enforced |= JOINT_BOUNDED
            else:
                enforced |= SINGULARITY_BOUNDED
    return enforced
