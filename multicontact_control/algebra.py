"""
Small dense linear algebra for compiled code: for 6 x 6 plain loops are faster than LAPACK.

What has three elements is returned as a tuple, which compiled code keeps in registers; what has
more is filled in, so that nothing is allocated.
"""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np

Triple = tuple[float, float, float]
MOST_SWEEPS = 15  # of Jacobi's rotations; 6 are enough
SMALLEST_SQUARE = 1e-30  # of what is left beside the diagonal, over that on it


@compiled
def cholesky(A: Matrix, L: Matrix, smallest_pivot: float) -> bool:
    """
    Factorise A = L L^T, shape (n, n); return whether A is positive definite.

    The upper triangle of A is read, the lower one of L filled. Of every diagonal element of A more
    than the share `smallest_pivot` must be left once the columns before are taken out.
    """
    n = A.shape[0]
    for j in range(n):
        pivot = A[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        if not pivot > smallest_pivot * A[j, j]:  # or it is not a number
            return False
        L[j, j] = np.sqrt(pivot)
        scale = 1.0 / L[j, j]
        for i in range(j + 1, n):
            total = A[j, i]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total * scale
    return True


@compiled
def solve_lower(L: Matrix, x: Vector) -> None:
    """Replace x, shape (n,), by L^-1 x for a lower triangular L."""
    for i in range(x.shape[0]):
        total = x[i]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i]


@compiled
def solve_lower_columns(L: Matrix, X: Matrix) -> None:
    """Replace X, shape (n, m), by L^-1 X for a lower triangular L."""
    n, columns = X.shape
    for i in range(n):
        for k in range(i):
            factor = L[i, k]
            for j in range(columns):
                X[i, j] -= factor * X[k, j]
        scale = 1.0 / L[i, i]
        for j in range(columns):
            X[i, j] *= scale


@compiled
def solve_lower_transposed(L: Matrix, x: Vector) -> None:
    """Replace x, shape (n,), by L^-T x for a lower triangular L."""
    for i in range(x.shape[0] - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, x.shape[0]):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i]


@compiled
def solve_cholesky(L: Matrix, x: Vector) -> None:
    """Replace x, shape (n,), by (L L^T)^-1 x, with L of `cholesky`."""
    solve_lower(L, x)
    solve_lower_transposed(L, x)


@compiled
def dot(x: Vector | Triple, y: Vector | Triple) -> float:
    """Return the scalar product x^T y of two vectors, shape (n,), summed in their order."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@compiled
def vector_length(x: Vector | Triple) -> float:
    """Return the Euclidean length |x| of a vector, shape (n,)."""
    return np.sqrt(dot(x, x))


@compiled
def add_vector(x: Vector, y: Vector | Triple) -> None:
    """Add a vector y to x in place, both of shape (n,)."""
    for i in range(len(x)):
        x[i] += y[i]


@compiled
def add_scaled_vector(x: Vector, factor: float, y: Vector | Triple) -> None:
    """Add a multiple of y to x, both of shape (n,)."""
    for i in range(len(x)):
        x[i] += factor * y[i]


@compiled
def multiply_vector(A: Matrix, x: Vector, y: Vector) -> None:
    """Fill y, shape (n,), with A x, A of shape (n, m) and x of shape (m,)."""
    for i in range(A.shape[0]):
        y[i] = dot(A[i], x)


@compiled
def gram_matrix(X: Matrix, G: Matrix) -> None:
    """Fill G, shape (m, m), with X^T X, the scalar products of the columns of X, shape (n, m)."""
    for i in range(X.shape[1]):
        multiply_vector(X.T, X[:, i], G[i])


@compiled
def frobenius_norm(A: Matrix) -> float:
    """Return the root of the sum of all squares, which no singular value exceeds."""
    total = 0.0
    for i in range(A.shape[0]):
        total += dot(A[i], A[i])
    return np.sqrt(total)


@compiled
def invert_symmetric(A: Matrix, factor: Matrix, root: Matrix, inverse: Matrix) -> bool:
    """
    Fill in A^-1 of a symmetric A, shape (n, n); return whether A is positive definite.

    `factor`, L of A = L L^T, and `root`, L^-1, are filled in as well.
    """
    if not cholesky(A, factor, 0.0):
        return False
    root[:] = 0.0
    for i in range(A.shape[0]):
        root[i, i] = 1.0
    solve_lower_columns(factor, root)
    gram_matrix(root, inverse)
    return True


@compiled
def diagonalise(A: Matrix, vectors: Matrix) -> None:
    """
    Leave the eigenvalues of a symmetric A, shape (n, n), on its diagonal, in no order.

    Its unit eigenvectors become the columns of `vectors`. By Jacobi's rotations, each of which
    makes an element beside the diagonal 0; sweeps over all of them converge quadratically. Unlike
    LAPACK's, these allocate nothing.
    """
    n = A.shape[0]
    vectors[:n, :n] = 0.0
    for i in range(n):
        vectors[i, i] = 1.0
    for _ in range(MOST_SWEEPS):
        beside = 0.0
        total = 0.0
        for i in range(n):
            total += A[i, i] * A[i, i]
            for j in range(i + 1, n):
                beside += A[i, j] * A[i, j]
        if not beside > SMALLEST_SQUARE * total:  # or they are not numbers
            return
        negligible = SMALLEST_SQUARE * total / (n * n)
        for i in range(n):
            for j in range(i + 1, n):
                if A[i, j] * A[i, j] > negligible:
                    rotate_pair(A, vectors, i, j)


@compiled
def rotate_pair(A: Matrix, vectors: Matrix, i: int, j: int) -> None:
    """Turn axes i and j so that a symmetric A has 0 between them; see `diagonalise`."""
    slope = (A[j, j] - A[i, i]) / (2.0 * A[i, j])
    tangent = 1.0 / (abs(slope) + np.sqrt(slope * slope + 1.0))
    if slope < 0.0:
        tangent = -tangent
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for k in range(A.shape[0]):
        first, second = A[k, i], A[k, j]
        A[k, i] = cosine * first - sine * second
        A[k, j] = sine * first + cosine * second
        first, second = vectors[k, i], vectors[k, j]
        vectors[k, i] = cosine * first - sine * second
        vectors[k, j] = sine * first + cosine * second
    for k in range(A.shape[0]):
        first, second = A[i, k], A[j, k]
        A[i, k] = cosine * first - sine * second
        A[j, k] = sine * first + cosine * second


@compiled
def vector_between(start: Vector | Triple, end: Vector | Triple) -> Triple:
    """Return the vector from one point to another, end - start, in their frame [m]."""
    return end[0] - start[0], end[1] - start[1], end[2] - start[2]


@compiled
def linear_combination(
    a: float, x: Vector | Triple, b: float, y: Vector | Triple
) -> Triple:
    """Return a x + b y of two vectors of three elements and two numbers."""
    return a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2]


@compiled
def divide_vector(vector: Vector | Triple, divisor: float) -> Triple:
    """Return a vector of three elements over a number, which the caller knows not to be 0."""
    return vector[0] / divisor, vector[1] / divisor, vector[2] / divisor


@compiled
def cross(a: Vector | Triple, b: Vector | Triple) -> Triple:
    """Return the vector product a x b, which is perpendicular to both."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@compiled
def component_across(vector: Vector | Triple, axis: Vector | Triple) -> Triple:
    """Return the component of a vector perpendicular to a unit axis, v - (v^T a) a."""
    return linear_combination(1.0, vector, -dot(vector, axis), axis)


@compiled
def rotate_vector(rotation: Matrix, vector: Vector | Triple) -> Triple:
    """Return R v of a rotation R, shape (3, 3), and a vector, shape (3,)."""
    return dot(rotation[0], vector), dot(rotation[1], vector), dot(rotation[2], vector)


@compiled
def velocity_at(twist: Vector, lever: Vector | Triple) -> Triple:
    """
    Return v + omega x l, the velocity at the end of a lever of a body with a twist [v, omega].

    Twist and lever have the same axes; shapes (6,) and (3,) [m/s, rad/s], [m].
    """
    x, y, z = cross(twist[3:], lever)
    return x + twist[0], y + twist[1], z + twist[2]


@compiled
def turn_rotation_by_vector(vector: Vector | Triple, rotation: Matrix) -> None:
    """
    Turn a rotation in place, shape (3, 3), by a rotation vector, shape (3,) [rad] (Rodrigues).

    R is replaced by exp([vector]) R: the vector has the axes of the rows of R.
    """
    angle = vector_length(vector)
    if angle < 1e-12:
        return
    axis = divide_vector(vector, angle)
    sine = np.sin(angle)
    versine = 1.0 - np.cos(angle)
    for j in range(3):
        once = cross(axis, rotation[:, j])
        twice = cross(axis, once)
        for i in range(3):
            rotation[i, j] += sine * once[i]
            rotation[i, j] += versine * twice[i]


@compiled
def quintic_blend(elapsed: float, duration: float) -> Triple:
    """
    Return b = 10 x^3 - 15 x^4 + 6 x^5, x = elapsed / duration, and its two derivatives in time.

    b goes from 0 to 1 with speed and acceleration 0 at both ends, and stays there.
    """
    if elapsed >= duration:
        return 1.0, 0.0, 0.0
    x = max(0.0, elapsed / duration)
    rest = 1.0 - x
    blend = x**3.0 * (10.0 + x * (-15.0 + 6.0 * x))
    rate = 30.0 * x**2.0 * rest**2.0 / duration
    acceleration = 60.0 * x * rest * (1.0 - 2.0 * x) / duration**2.0
    return blend, rate, acceleration
