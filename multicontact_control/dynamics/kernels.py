"""The arm at its operational point and the error of a rotation, compiled."""

from __future__ import annotations

from multicontact_control.algebra import (
    cholesky,
    gram,
    multiply,
    multiply_transposed,
    solve_lower,
    solve_lower_columns,
)
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np


@compiled
def mobility_and_inertia(
    mass_matrix: Matrix, jacobian: Matrix, max_condition: float, singular_mobility: float,
    L: Matrix, Y: Matrix, mobility: Matrix, Lambda: Matrix,
) -> float:
    """
    Work out Lambda = (J M^-1 J^T)^-1 (P04 eq. 23) and what leads to it.

    M = L L^T, Y = L^-1 J^T, Lambda^-1 = Y^T Y. The condition number of Lambda^-1 is at most the
    product of the Frobenius norms of the two; only when that is too large is it worked out.
    Near a singularity Lambda^-1 is damped, see `mobility_damping`.

    Parameters
    ----------
    mass_matrix
        M, shape (n, n), only its upper triangle is read [kg m^2].
    jacobian
        J, shape (6, n).
    max_condition
        Largest accepted condition number of Lambda^-1.
    singular_mobility
        Eigenvalue of Lambda^-1 up to which it is damped, 0 for not at all [1/kg].
    L, Y, mobility, Lambda
        Filled, shapes (n, n) (lower triangle), (n, 6), (6, 6), (6, 6).

    Returns
    -------
    float
        What was added to the diagonal of Lambda^-1, -1 if the arm cannot accelerate the
        operational point in every direction.

    """
    n = mass_matrix.shape[0]
    if not cholesky(mass_matrix, L, 0.0):
        return -1.0
    for i in range(n):
        for j in range(6):
            Y[i, j] = jacobian[j, i]
    solve_lower_columns(L, Y)
    gram(Y, mobility)
    damping = 0.0
    invertible = _invert(mobility, Lambda)
    # 1 / |Lambda| is at most the smallest eigenvalue: mostly that alone says enough.
    if singular_mobility > 0.0 and not (
            invertible and np.sqrt(_squared_norm(Lambda)) * singular_mobility <= 1.0):
        smallest = np.linalg.eigvalsh(mobility)[0]
        if smallest < singular_mobility:
            damping = 0.5 * singular_mobility * (1.0 - smallest / singular_mobility) ** 2
            for i in range(6):
                mobility[i, i] += damping
            invertible = _invert(mobility, Lambda)
    if not invertible:
        return -1.0
    if np.sqrt(_squared_norm(mobility) * _squared_norm(Lambda)) < max_condition:
        return damping
    eigenvalues = np.linalg.eigvalsh(mobility)
    return damping if eigenvalues[0] * max_condition > eigenvalues[-1] else -1.0


@compiled
def _invert(A: Matrix, inverse: Matrix) -> bool:
    """Fill in the inverse of a symmetric matrix; return whether it is positive definite."""
    factor = np.empty((6, 6))
    if not cholesky(A, factor, 0.0):
        return False
    root = np.eye(6)
    solve_lower_columns(factor, root)
    gram(root, inverse)
    return True


@compiled
def _squared_norm(A: Matrix) -> float:
    """Return the sum of the squares of all elements."""
    total = 0.0
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            total += A[i, j] * A[i, j]
    return total


@compiled
def bias_acceleration(
    L: Matrix, Y: Matrix, bias_torque: Vector, jacobian_rate: Matrix, velocity: Vector,
    acceleration: Vector,
) -> None:
    """
    Fill in the acceleration whose force is mu + p = Lambda (J M^-1 (C v + g) - dJ/dt v).

    This is P04 eq. 23 with J_bar^T = Lambda J M^-1.

    Parameters
    ----------
    L, Y
        From `mobility_and_inertia`.
    bias_torque
        C v + g, shape (n,) [N m].
    jacobian_rate, velocity
        dJ/dt, shape (6, n), and v, shape (n,) [rad/s].
    acceleration
        Filled, shape (6,) [m/s^2, rad/s^2].

    """
    reduced = bias_torque.copy()
    solve_lower(L, reduced)
    multiply_transposed(Y, reduced, acceleration)
    for i in range(6):
        for j in range(velocity.shape[0]):
            acceleration[i] -= jacobian_rate[i, j] * velocity[j]


@compiled
def add_nullspace_torque(
    mass_matrix: Matrix, jacobian: Matrix, L: Matrix, Y: Matrix, Lambda: Matrix,
    bias_torque: Vector, velocity: Vector, damping: float, torque: Vector,
) -> None:
    """
    Compensate and damp the motion that the operational point does not see.

    Gamma += (1 - J^T J_bar^T)(C v + g - d M v).

    Parameters
    ----------
    mass_matrix, jacobian, L, Y, Lambda
        As for `mobility_and_inertia`.
    bias_torque, velocity
        C v + g [N m] and v [rad/s], shape (n,).
    damping
        d [1/s].
    torque
        Gamma, added to, shape (n,) [N m].

    """
    n = velocity.shape[0]
    free = np.empty(n)
    for i in range(n):
        momentum = 0.0
        for j in range(n):
            momentum += mass_matrix[min(i, j), max(i, j)] * velocity[j]
        free[i] = bias_torque[i] - damping * momentum
        torque[i] += free[i]
    solve_lower(L, free)
    acceleration = np.empty(6)
    force = np.empty(6)
    multiply_transposed(Y, free, acceleration)
    multiply(Lambda, acceleration, force)
    for j in range(n):
        for i in range(6):
            torque[j] -= jacobian[i, j] * force[i]


@compiled
def quaternion_of(rotation: Matrix, quaternion: Vector) -> None:
    """
    Fill in the unit quaternion of a rotation.

    Shepperd's method: of the four ways to take the roots, the one without cancellation.

    Parameters
    ----------
    rotation
        Shape (3, 3).
    quaternion
        Filled, scalar last, shape (4,).

    """
    trace = rotation[0, 0] + rotation[1, 1] + rotation[2, 2]
    largest = 3
    greatest = trace
    for i in range(3):
        if rotation[i, i] > greatest:
            largest, greatest = i, rotation[i, i]
    if largest == 3:
        quaternion[0] = rotation[2, 1] - rotation[1, 2]
        quaternion[1] = rotation[0, 2] - rotation[2, 0]
        quaternion[2] = rotation[1, 0] - rotation[0, 1]
        quaternion[3] = 1.0 + trace
    else:
        i = largest
        j = (i + 1) % 3
        k = (i + 2) % 3
        quaternion[i] = 1.0 - trace + 2.0 * rotation[i, i]
        quaternion[j] = rotation[j, i] + rotation[i, j]
        quaternion[k] = rotation[k, i] + rotation[i, k]
        quaternion[3] = rotation[k, j] - rotation[j, k]
    length = 0.0
    for i in range(4):
        length += quaternion[i] * quaternion[i]
    length = np.sqrt(length)
    for i in range(4):
        quaternion[i] /= length


@compiled
def logarithm(error: Matrix, vector: Vector) -> None:
    """
    Fill in the rotation vector of a rotation.

    Parameters
    ----------
    error
        Shape (3, 3).
    vector
        Filled, shape (3,) [rad].

    """
    vector[0] = 0.5 * (error[2, 1] - error[1, 2])
    vector[1] = 0.5 * (error[0, 2] - error[2, 0])
    vector[2] = 0.5 * (error[1, 0] - error[0, 1])
    cosine = 0.5 * (error[0, 0] + error[1, 1] + error[2, 2] - 1.0)
    sine = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if cosine < -0.99:  # near half a turn the skew part vanishes and no longer names the axis
        quaternion = np.empty(4)
        quaternion_of(error, quaternion)
        sine = np.sqrt(quaternion[0] ** 2 + quaternion[1] ** 2 + quaternion[2] ** 2)
        angle = 2.0 * np.arctan2(sine, abs(quaternion[3]))
        sign = 1.0 if quaternion[3] >= 0.0 else -1.0
        for i in range(3):
            vector[i] = sign * angle * quaternion[i] / sine
    elif sine >= 1e-9:
        factor = np.arctan2(sine, cosine) / sine
        for i in range(3):
            vector[i] *= factor


@compiled
def rotation_vector(rotation_des: Matrix, rotation: Matrix, vector: Vector) -> None:
    """
    Fill in log(R_des R^T), the rotation from an orientation to a desired one, in world axes.

    Parameters
    ----------
    rotation_des, rotation
        Shape (3, 3).
    vector
        Filled, shape (3,) [rad].

    """
    error = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            error[i, j] = (rotation_des[i, 0] * rotation[j, 0]
                           + rotation_des[i, 1] * rotation[j, 1]
                           + rotation_des[i, 2] * rotation[j, 2])
    logarithm(error, vector)
