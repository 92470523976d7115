"""All active observers of an arm at once, compiled."""

from __future__ import annotations

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.force.kalman import kalman_update

# Rows of `report`.
FORCE, RATE, INNOVATION, PRIOR_VARIANCE, VARIANCE_USED = range(5)


@compiled
def observe_and_command(
    Phi_c: Matrix, Phi_n: Matrix, Gamma: Matrix, feedback: Matrix, Q: Matrix, P_0: float,
    x_est: Matrix, P: Matrix, command: Vector, running: Mask, active: Mask, alpha_meas: Vector,
    alpha_des: Vector, noise_variance: Vector, inputs: Vector, report: Matrix,
) -> None:
    """
    Update the observer of every active contact and work out its input.

    u_k = L_1 f_des - [L_r 1] [x_est; p_est] (P04 eq. 36) on the estimate of eqs 37-41. A contact
    that has just become active starts from its measured force at rest, and nothing leads to its
    first sample.

    Parameters
    ----------
    Phi_c, Phi_n, Gamma, feedback, Q, P_0
        Of each contact: closed and open loop, shape (r, m, m), input, feedback and diagonal of
        the process noise, shape (r, m); initial variance of every state.
    x_est, P, command, running
        Memory: estimate (r, m), covariance (r, m, m), r = L_1 f_des of the tick before (r,), and
        whether the observer ran then (r,). Overwritten.
    active
        Which contacts are force controlled, shape (r,).
    alpha_meas, alpha_des
        Forces, shape (r,) [N].
    noise_variance
        R_k, shape (r,) [N^2].
    inputs
        Filled with u, 0 where not active, shape (r,) [m/s^2].
    report
        Filled with estimated force and rate, innovation, its predicted variance and R, 0 where
        not active, shape (5, r).

    """
    count, size = x_est.shape
    for i in range(count):
        inputs[i] = 0.0
        for row in range(report.shape[0]):
            report[row, i] = 0.0
        if not active[i]:
            running[i] = False
            continue
        if running[i]:
            innovation, prior_variance = kalman_update(
                x_est[i], P[i], Phi_c[i], Phi_n[i], Gamma[i], Q[i], command[i], alpha_meas[i],
                noise_variance[i])
            report[INNOVATION, i] = innovation
            report[PRIOR_VARIANCE, i] = prior_variance
            report[VARIANCE_USED, i] = noise_variance[i]
        else:
            running[i] = True
            x_est[i] = 0.0
            x_est[i, 0] = alpha_meas[i]
            P[i] = 0.0
            for j in range(size):
                P[i, j, j] = P_0
        command[i] = feedback[i, 0] * alpha_des[i]
        inputs[i] = command[i]
        for j in range(size):
            inputs[i] -= feedback[i, j] * x_est[i, j]
        report[FORCE, i] = x_est[i, 0]
        report[RATE, i] = x_est[i, 1]
