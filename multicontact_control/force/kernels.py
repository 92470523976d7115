"""All active observers of an arm at once, compiled."""

from __future__ import annotations

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.force.kalman import kalman_update

# Rows of `report`, one column per contact.
(MEASURED, DESIRED, ESTIMATED, RATE, INNOVATION, PRIOR_VARIANCE,
 VARIANCE_USED) = REPORT_ROWS = range(7)
# First index of the arrays of an `ObserverBank`.
PHI_C, PHI_N, COVARIANCE = MATRICES = range(3)
GAMMA, FEEDBACK, PROCESS_NOISE, ESTIMATE = VECTORS = range(4)
COMMAND, RUNNING = SCALARS = range(2)


@compiled
def observe_and_command(
    matrices: Matrix, vectors: Matrix, scalars: Matrix, P_0: float, active: Mask,
    alpha_des: Vector, noise_variance: Vector, report: Matrix, inputs: Vector,
) -> None:
    """
    Update the observer of every active contact and work out its input.

    u_k = L_1 f_des - [L_r 1] [x_est; p_est] (P04 eq. 36) on the estimate of eqs 37-41. A contact
    that has just become active starts from its measured force at rest, and nothing leads to its
    first sample.

    Parameters
    ----------
    matrices, vectors, scalars
        Designs and memories of all observers, see `ObserverBank`; memories are overwritten.
    P_0
        Initial variance of every state.
    active
        Which contacts are force controlled, shape (r,).
    alpha_des
        Desired forces, shape (r,) [N].
    noise_variance
        R_k, shape (r,) [N^2].
    report
        The measured forces are there; everything else is filled in, 0 where not active,
        shape (7, r).
    inputs
        Filled with u, 0 where not active, shape (r,) [m/s^2].

    """
    x_est, P = vectors[ESTIMATE], matrices[COVARIANCE]
    Phi_c, Phi_n, Gamma = matrices[PHI_C], matrices[PHI_N], vectors[GAMMA]
    feedback, Q = vectors[FEEDBACK], vectors[PROCESS_NOISE]
    command, running = scalars[COMMAND], scalars[RUNNING]
    count, size = x_est.shape
    for i in range(count):
        inputs[i] = 0.0
        for row in range(ESTIMATED, report.shape[0]):
            report[row, i] = 0.0
        report[DESIRED, i] = alpha_des[i]
        if not active[i]:
            running[i] = 0.0
            continue
        if running[i] > 0.0:
            report[INNOVATION, i], report[PRIOR_VARIANCE, i] = kalman_update(
                x_est[i], P[i], Phi_c[i], Phi_n[i], Gamma[i], Q[i], command[i],
                report[MEASURED, i], noise_variance[i])
            report[VARIANCE_USED, i] = noise_variance[i]
        else:
            running[i] = 1.0
            for j in range(size):
                x_est[i, j] = 0.0
                for k in range(size):
                    P[i, j, k] = P_0 if j == k else 0.0
            x_est[i, 0] = report[MEASURED, i]
        command[i] = feedback[i, 0] * alpha_des[i]
        inputs[i] = command[i]
        for j in range(size):
            inputs[i] -= feedback[i, j] * x_est[i, j]
        report[ESTIMATED, i] = x_est[i, 0]
        report[RATE, i] = x_est[i, 1]
