"""The arm's dynamics at the operational point (P04 eqs 23-25)."""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import (
    cholesky,
    cross,
    diagonalise,
    dot,
    frobenius_norm,
    gram_matrix,
    invert_symmetric,
    multiply_vector,
    solve_lower,
    solve_lower_columns,
    solve_lower_transposed,
)
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.dynamics.terms import ModelTerms
from multicontact_control.records import (
    Joint,
    Law,
    MAX_JOINTS,
    Record,
    record_dtype,
    Records,
)
import numpy as np

MAX_MOBILITY_CONDITION = 1e8  # of Lambda^-1; a posture is singular beyond
STOP_MARGIN = 0.1  # rad before its stop, within which a joint is pushed away from it


class InertiaSpace(Record, Protocol):
    """What `compute_mobility_and_inertia` fills in; the first n rows and columns are used. One."""

    L: Annotated[Matrix, MAX_JOINTS, MAX_JOINTS]  # M = L L^T, lower triangle
    Y: Annotated[Matrix, MAX_JOINTS, 6]  # L^-1 J^T

    # J M^-1 J^T, damped near singularities, and its inverse.
    mobility: Annotated[Matrix, 6, 6]
    Lambda: Annotated[Matrix, 6, 6]

    # Eigenvalues of J M^-1 J^T, on the diagonal, and its eigenvectors as columns, if they have
    # been needed; see `diagonalise_mobility`.
    eigenvalues: Annotated[Matrix, 6, 6]
    directions: Annotated[Matrix, 6, 6]
    diagonalised: bool

    # Worked with: the factor of Lambda^-1, and the inverse of that.
    factor: Annotated[Matrix, 6, 6]
    root: Annotated[Matrix, 6, 6]


INERTIA_SPACE = record_dtype(InertiaSpace)


class NullspaceSpace(Record, Protocol):
    """What `add_nullspace_torque` works in; the first n numbers are used. One."""

    pull: Annotated[Vector, MAX_JOINTS]  # k_q (q_0 - q) + s [rad/s^2]
    free: Annotated[Vector, MAX_JOINTS]  # torque before it is projected [N m]

    # Of the operational point under that torque [m/s^2, rad/s^2].
    acceleration: Annotated[Vector, 6]


@compiled
def compute_mobility_and_inertia(
    mass_matrix: Matrix,
    jacobian: Matrix,
    singular_mobility: float,
    space: InertiaSpace,
) -> tuple[float, float]:
    """
    Work out Lambda = (J M^-1 J^T)^-1 (P04 eq. 23) and what leads to it.

    M = L L^T, Y = L^-1 J^T, Lambda^-1 = Y^T Y. Below an eigenvalue e_0 of Lambda^-1,
    d = e_0 / 2 (1 - e / e_0)^2 is added to its diagonal: damped least squares in the metric of M.
    Lambda then has no eigenvalue above 2 / e_0 and changes smoothly; away from singularities it
    is exact. The smallest eigenvalue of Lambda^-1 is 1 / |Lambda|_F or more: where that is enough,
    no eigenvalues are computed.

    Parameters
    ----------
    mass_matrix, jacobian
        M, shape (n, n), of which the upper triangle is read [kg m^2], and J, shape (6, n).
    singular_mobility
        e_0, 0 for no damping [1/kg].
    space
        A record of `INERTIA_SPACE`, filled in.

    Returns
    -------
    tuple[float, float]
        d, -1 if the arm cannot accelerate the operational point in every direction, and the
        smallest eigenvalue of Lambda^-1 before it is damped, at least [1/kg].

    """
    n = mass_matrix.shape[0]
    mobility = space.mobility
    space.diagonalised = False
    L = space.L[:n, :n]
    Y = space.Y[:n]
    if not cholesky(mass_matrix, L, 0.0):
        return -1.0, 0.0
    Y[:] = jacobian.T
    solve_lower_columns(L, Y)
    gram_matrix(Y, mobility)
    smallest = 0.0
    trace = 0.0
    for i in range(6):
        trace += mobility[i, i]
    if invert_symmetric(mobility, space.factor, space.root, space.Lambda):
        smallest = 1.0 / frobenius_norm(space.Lambda)
    if smallest >= singular_mobility and smallest * MAX_MOBILITY_CONDITION > trace:
        return 0.0, smallest
    diagonalise_mobility(space)
    eigenvalues = space.eigenvalues
    smallest = eigenvalues[0, 0]
    largest = eigenvalues[0, 0]
    for i in range(1, 6):
        smallest = min(smallest, eigenvalues[i, i])
        largest = max(largest, eigenvalues[i, i])
    damping = 0.0
    if singular_mobility > 0.0 and smallest < singular_mobility:
        damping = 0.5 * singular_mobility * (1.0 - smallest / singular_mobility) ** 2
        for i in range(6):
            mobility[i, i] += damping
    # False for a number that is none, too.
    is_regular = (smallest + damping) * MAX_MOBILITY_CONDITION > largest + damping
    if not is_regular:
        return -1.0, smallest
    invert_symmetric(mobility, space.factor, space.root, space.Lambda)
    return damping, smallest


@compiled
def diagonalise_mobility(space: InertiaSpace) -> None:
    """Fill in eigenvalues and eigenvectors of J M^-1 J^T, unless they are."""
    if not space.diagonalised:
        space.diagonalised = True
        space.eigenvalues[:] = space.mobility
        diagonalise(space.eigenvalues, space.directions)


@compiled
def compute_mobility_gradient(
    jacobian: Matrix,
    L: Matrix,
    Y: Matrix,
    direction: Vector,
    joint_rates: Vector,
    gradient: Vector,
) -> None:
    """
    Fill in how an eigenvalue of Lambda^-1 changes with each joint, shape (n,) [1/kg per rad].

    d lambda / d q_k = 2 u^T (dJ / d q_k) M^-1 J^T u for its eigenvector u, the `direction`, shape
    (6,). How M changes is left out, which matters little where J is nearly singular. Of a serial
    chain in world axes, joint k turns column [v_i, w_i] of J beyond it, and moves the operational
    point for column i before it:
    d v_i / d q_k = w_k x v_i for k <= i, w_i x v_k for k > i, and d w_i / d q_k = w_k x w_i for
    k <= i, 0 for k > i.

    Parameters
    ----------
    jacobian
        J, shape (6, n), linear rows first, world axes.
    L, Y
        Of M = L L^T and Y = L^-1 J^T: `InertiaSpace.L`, shape (n, n), and `.Y`, shape (n, 6).
    direction
        Unit eigenvector u, shape (6,).
    joint_rates
        Overwritten with M^-1 J^T u, shape (n,).
    gradient
        Filled in, shape (n,).

    """
    n = jacobian.shape[1]
    multiply_vector(Y, direction, joint_rates)
    solve_lower_transposed(L, joint_rates)  # M^-1 J^T u
    linear = direction[:3]
    angular = direction[3:]
    for k in range(n):
        gradient[k] = 0.0
        for i in range(n):
            nearer = min(k, i)  # to the base
            farther = max(k, i)
            twice_rate = 2.0 * joint_rates[i]
            linear_change = cross(jacobian[3:, nearer], jacobian[:3, farther])
            gradient[k] += twice_rate * dot(linear, linear_change)
            if k <= i:
                angular_change = cross(jacobian[3:, k], jacobian[3:, i])
                gradient[k] += twice_rate * dot(angular, angular_change)


@compiled
def choose_posture(joints: Records[Joint]) -> None:
    """
    Set q_0 of the null space: as told, or where the arm is, away from the stops.

    What lies beyond a stop would be fought over. `joints` are records of `JOINT`, shape (n,).
    """
    for joint in joints:
        config = joint.config
        config.posture = joint.q
        if not np.isnan(config.told_posture):
            config.posture = config.told_posture
        config.posture = max(config.posture, config.lower + STOP_MARGIN)
        config.posture = min(config.posture, config.upper - STOP_MARGIN)


@compiled
def add_nullspace_torque(
    joints: Records[Joint],
    terms: ModelTerms,
    inertia: InertiaSpace,
    law: Law,
    space: NullspaceSpace,
) -> None:
    """
    Give the motion that the operational point does not see a posture, off the stops, and damp it.

    Gamma += (1 - J^T J_bar^T)(C v + g + M (k_q (q_0 - q) + s - d v)), s = k_s (m - x)^2 / m away
    from a stop at a distance x below the margin m. J M^-1 of what is added is 0, gravity and
    Coriolis' part aside.

    Parameters
    ----------
    joints
        Records of `JOINT`, shape (n,), whose torque is added to.
    terms
        Of the arm's model: M and J are read.
    inertia
        Record of `INERTIA_SPACE` that `compute_mobility_and_inertia` has filled in of these.
    law
        Record of `LAW`, which has d, k_q and k_s.
    space
        Overwritten.

    """
    n = joints.shape[0]
    mass_matrix = terms.mass_matrix
    free = space.free[:n]
    for j in range(n):
        joint = joints[j]
        config = joint.config
        below = max(STOP_MARGIN - (joint.q - config.lower), 0.0)
        above = max(STOP_MARGIN - (config.upper - joint.q), 0.0)
        push_up = law.stop_stiffness * below * below / STOP_MARGIN
        push_down = law.stop_stiffness * above * above / STOP_MARGIN
        push = push_up - push_down
        space.pull[j] = law.posture_stiffness * (config.posture - joint.q) + push
    for i in range(n):
        momentum = 0.0
        for j in range(n):
            mass = mass_matrix[min(i, j), max(i, j)]
            momentum += mass * joints[j].velocity
        free[i] = joints[i].bias_torque - law.nullspace_damping * momentum
        if law.posture_stiffness > 0.0:
            for j in range(n):
                mass = mass_matrix[min(i, j), max(i, j)]
                free[i] += mass * space.pull[j]
        joints[i].answer.torque += free[i]
    solve_lower(inertia.L[:n, :n], free)
    multiply_vector(inertia.Y[:n].T, free, space.acceleration)
    for j in range(n):
        for i in range(6):
            force = dot(inertia.Lambda[i], space.acceleration)
            joints[j].answer.torque -= terms.jacobian[i, j] * force
