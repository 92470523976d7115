"""One update of a Kalman filter with one measured state, compiled."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np


@compiled
def predict(
    x: Vector, P: Matrix, Phi_c: Matrix, Phi_n: Matrix, Gamma: Vector, q_diag: Vector,
    command: float, x_pred: Vector, half: Matrix,
) -> None:
    """
    Predict state and covariance, x_1 = Phi_c x + Gamma r and P_1 = Phi_n P Phi_n^T + Q.

    Parameters
    ----------
    x, P, Phi_c, Phi_n, Gamma, q_diag, command
        See `kalman_update`; P becomes P_1.
    x_pred
        Filled with x_1, shape (n,).
    half
        Filled with Phi_n P, shape (n, n).

    """
    n = x.shape[0]
    for i in range(n):
        total = Gamma[i] * command
        for j in range(n):
            total += Phi_c[i, j] * x[j]
            half[i, j] = 0.0
        x_pred[i] = total
        for k in range(n):
            factor = Phi_n[i, k]
            if factor != 0.0:  # the shift register makes most of them zero
                for j in range(n):
                    half[i, j] += factor * P[k, j]
    for i in range(n):
        for j in range(i, n):
            total = 0.0
            for k in range(n):
                if Phi_n[j, k] != 0.0:
                    total += half[i, k] * Phi_n[j, k]
            P[i, j] = total
            P[j, i] = total
        P[i, i] += q_diag[i]


@compiled
def correct(
    x: Vector, P: Matrix, x_pred: Vector, innovation: float, R: float, covariance: Vector,
) -> None:
    """
    Correct state and covariance by the innovation, x = x_1 + K (y - C x_1), P = P_1 - K C P_1.

    Parameters
    ----------
    x, P, R
        See `kalman_update`; P is P_1 at first.
    x_pred, innovation
        x_1, shape (n,), and y - C x_1.
    covariance
        Room for P_1 C^T, shape (n,).

    """
    n = x.shape[0]
    total_variance = P[0, 0] + R
    for i in range(n):
        covariance[i] = P[0, i]
    remainder = R / total_variance
    for i in range(n):
        gain = covariance[i] / total_variance
        x[i] = x_pred[i] + gain * innovation
        P[0, i] = covariance[i] * remainder
        P[i, 0] = P[0, i]
        if i:
            for j in range(i, n):
                P[i, j] -= gain * covariance[j]
                P[j, i] = P[i, j]


@compiled
def kalman_update(
    x: Vector, P: Matrix, Phi_c: Matrix, Phi_n: Matrix, Gamma: Vector, q_diag: Vector,
    command: float, y: float, R: float,
) -> tuple[float, float]:
    """
    Take one sample of the first state into a state estimate, in place.

    Predicts the state with the closed loop, x_1 = Phi_c x + Gamma r (P04 eqs 37-38), and the
    covariance with the open one, P_1 = Phi_n P Phi_n^T + Q (eqs 40-41); then, with C = e_1^T,
    K = P_1 C^T / (C P_1 C^T + R), x = x_1 + K (y - C x_1), P = P_1 - K C P_1 (eqs 37, 39, 40).

    P stays symmetric because only its upper triangle is computed and then mirrored. Its first
    row is written as R / (C P_1 C^T + R) times that of P_1, the same thing as P_1 - K C P_1
    without the difference of two nearly equal numbers: the variance of the measured state stays
    positive however far R drops. What remains is the Schur complement of the other states,
    where rounding is small against the process noise.

    Parameters
    ----------
    x
        State estimate, shape (n,); overwritten. The first state is the measured one.
    P
        Its covariance, shape (n, n); overwritten.
    Phi_c, Phi_n
        Closed-loop and open-loop transition, shape (n, n).
    Gamma
        Input vector, shape (n,).
    q_diag
        Diagonal of Q, shape (n,).
    command
        r of the tick before.
    y
        Measurement of the first state.
    R
        Its variance.

    Returns
    -------
    tuple
        Innovation y - C x_1 and its share from the prediction, C P_1 C^T.

    """
    half = np.empty_like(P)
    x_pred = np.empty_like(x)
    predict(x, P, Phi_c, Phi_n, Gamma, q_diag, command, x_pred, half)
    prior_variance = P[0, 0]
    innovation = y - x_pred[0]
    correct(x, P, x_pred, innovation, R, half[0])
    return innovation, prior_variance
