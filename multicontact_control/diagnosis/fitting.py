"""The fit over the joints that several explanations ask for."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Matrix, Vector
import numpy as np

# Share of the largest singular value, below which a direction is left free.
SMALLEST_SHARE = 0.03


def fit_over_joints(shares: Matrix, torques: Matrix, thresholds: Vector) -> Matrix:
    """
    Return the x of least squares in shares x = torques, each joint over its threshold.

    Parameters
    ----------
    shares
        What one unit of each unknown gives in every joint, shape (n, k).
    torques
        What the joints show, shape (n,) or (n, m) [N m].
    thresholds
        Of each joint's residual, shape (n,) [N m].

    Returns
    -------
    Matrix
        Shape (k,) or (k, m); 0 along what the joints hardly show.

    """
    weights: Vector = 1.0 / thresholds
    weighted_shares = shares * weights[:, None]
    weighted_torques = (torques.T * weights).T
    solution: Any = np.linalg.lstsq(
        weighted_shares, weighted_torques, rcond=SMALLEST_SHARE
    )[0]
    return solution
