"""Small dense linear algebra for compiled code: for 6 x 6 plain loops are faster than LAPACK."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np


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
    """Replace x, shape (n,), by (L L^T)^-1 x."""
    solve_lower(L, x)
    solve_lower_transposed(L, x)


@compiled
def dot(x: Vector, y: Vector) -> float:
    """Return x^T y, both of shape (n,)."""
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i] * y[i]
    return total


@compiled
def multiply(A: Matrix, x: Vector, y: Vector) -> None:
    """Fill y, shape (n,), with A x."""
    for i in range(A.shape[0]):
        y[i] = dot(A[i], x)


@compiled
def gram(X: Matrix, G: Matrix) -> None:
    """Fill G, shape (m, m), with X^T X, X of shape (n, m)."""
    for i in range(X.shape[1]):
        multiply(X.T, X[:, i], G[i])


@compiled
def cross(a: Vector, b: Vector, c: Vector) -> None:
    """Fill c with a x b, all of shape (3,); c must be neither of them."""
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def velocity_at(twist: Vector, lever: Vector, velocity: Vector) -> None:
    """Fill in v + omega x l, shape (3,), of a twist [v, omega] at its end of a lever."""
    cross(twist[3:], lever, velocity)
    velocity += twist[:3]


@compiled
def rotate_by(vector: Vector, rotation: Matrix) -> None:
    """Turn a rotation, shape (3, 3), by a rotation vector [rad] (Rodrigues)."""
    angle = np.sqrt(dot(vector, vector))
    if angle < 1e-12:
        return
    axis, once, twice = vector / angle, np.empty(3), np.empty(3)
    for j in range(3):
        column = rotation[:, j].copy()
        cross(axis, column, once)
        cross(axis, once, twice)
        rotation[:, j] = column + np.sin(angle) * once + (1.0 - np.cos(angle)) * twice
