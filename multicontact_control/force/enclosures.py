"""
Bounds that hold in spite of rounding.

Numbers are float64, u = 2^-53; a result is a matrix and, entry by entry, how far the exact one may
be from it. What is proved by it is that matrices are positive definite (Rump, Verification of
positive definiteness, BIT 46, 2006).
"""

from __future__ import annotations

from multicontact_control.arrays import Mask, Matrix
import numpy as np

UNIT = 2.0**-53  # u, half the distance from 1 to the next number
SMALLEST = 2.0**-1022  # what underflows is smaller


def product_error(left: Matrix, right: Matrix) -> Matrix:
    """
    Return what the computed product of magnitudes |left| |right| may be wrong by, entry by entry.

    |fl(A B) - A B| <= gamma_n |A| |B| with gamma_n = n u / (1 - n u) in any order of summation
    (Higham, Accuracy and Stability of Numerical Algorithms, eq. 3.13); both have stacks of
    matrices. Twice that, for the rounding of the bound.
    """
    terms = left.shape[-1]
    error: Matrix = 2.0 * terms * UNIT * (np.abs(left) @ np.abs(right)) + SMALLEST
    return error


def are_positive_definite(matrices: Matrix, radii: Matrix) -> Mask:
    """
    Return which symmetric matrices are surely positive definite, shape of the stack.

    None where a diagonal of the stack is not positive.

    A perturbation E, |E| <= radius, takes diag(sum_j radius_ij) off at most (Gershgorin). What is
    left is positive definite if the floating Cholesky factorisation of it less
    gamma_(n+1) / (1 - gamma_(n+1)) of its trace comes to an end (Rump, theorem 2.3).

    Parameters
    ----------
    matrices
        Shape (..., n, n); of each its symmetric part.
    radii
        How far the entries may be off, of the same shape, >= 0.

    """
    n = matrices.shape[-1]
    places = np.arange(n)
    diagonal = matrices[..., places, places]
    if not (diagonal > 0.0).all():
        return np.zeros(matrices.shape[:-2], dtype=bool)
    # Equilibrated by powers of 2, which rounds nothing and keeps what is positive definite.
    scale = 2.0 ** -np.round(0.5 * np.log2(diagonal))
    both = scale[..., :, None] * scale[..., None, :]
    symmetric = 0.5 * both * (matrices + np.swapaxes(matrices, -1, -2))
    radii = both * np.maximum(radii, np.swapaxes(radii, -1, -2))
    diagonal = symmetric[..., places, places]
    # Of the sums, of the halves and of what is taken off here: a few u of the trace.
    share = 4.0 * (n + 4) * UNIT
    size = diagonal.sum(axis=-1)[..., None] + SMALLEST
    symmetric[..., places, places] = (
        diagonal - 1.001 * radii.sum(axis=-1) - share * size
    )
    return _factorises(symmetric)


def _factorises(matrices: Matrix) -> Mask:
    """Return of which matrices the Cholesky factorisation comes to an end."""
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        if matrices.ndim == 2:
            return np.array(False)
        return np.array([_factorises(matrix) for matrix in matrices])
    return np.ones(matrices.shape[:-2], dtype=bool)
