"""The law `dob`: a disturbance observer with a Q-filter, around a proportional force loop."""

from __future__ import annotations

from multicontact_control.config import ForceConfig
from multicontact_control.force.linear_law import LinearLaw, LoopModel, sampled
import numpy as np


def design_dob(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = K_p (alpha_des - alpha) - d with d = Q (G_n^-1 alpha - e^(-s T_d) u).

    G_n = k / (s (s + K_2)) is the nominal plant and Q = omega^2 / (s + omega)^2. The inputs under
    way are kept in whole periods, at least one.

    Parameters
    ----------
    model
        What it is designed for.
    config
        Its gains are in `dob`.

    """
    values, h = config.dob, model.period
    omega, K_2, k = values.observer_bandwidth, model.damping_rate, model.stiffness
    gain = values.bandwidth * K_2 / k
    delay = max(1, round(model.input_delay / h))
    # Q alpha, in controllable form; of it s (s + K_2) / k makes Q G_n^-1 alpha.
    A = np.array([[0.0, 1.0], [-omega ** 2, -2.0 * omega]])
    force = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    C, D = np.zeros((3, 2)), np.zeros((3, 3))
    still = np.array([1.0 / omega ** 2, 0.0])  # of a filter whose input is constantly 1
    C[2], D[2, 0] = omega ** 2 / k * np.array([-omega ** 2, K_2 - 2.0 * omega]), omega ** 2 / k
    inverse = sampled(A, force, C, D, h, start_force=still)
    C[2], D[2, 0] = [omega ** 2, 0.0], 0.0
    acted = sampled(A, force, C, D, h, start_force=still)  # Q u
    # States: of Q G_n^-1 alpha, of Q u, and u of the last periods, oldest first.
    n, line = 4 + delay, 4
    A_all, B_all = np.zeros((n, n)), np.zeros((n, 3))
    C_all, D_all = np.zeros((3, n)), np.zeros((3, 3))
    A_all[:2, :2], B_all[:2] = inverse.A, inverse.B
    A_all[2:4, 2:4], A_all[2:4, line] = acted.A, acted.B[:, 0]
    for j in range(line, n - 1):
        A_all[j, j + 1] = 1.0
    C_all[2, :2], C_all[2, 2:4], C_all[2, line] = inverse.C[2], -acted.C[2], -acted.D[2, 0]
    D_all[1, 0], D_all[2] = 1.0, inverse.D[2]
    C_all[0] = -C_all[2]
    D_all[0] = gain * np.array([-1.0, 1.0, 0.0]) - D_all[2]
    A_all[n - 1], B_all[n - 1] = C_all[0], D_all[0]
    E, start_force, start_disturbance = np.zeros(n), np.zeros(n), np.zeros(n)
    E[n - 1] = 1.0
    start_force[:2] = inverse.start_force
    start_disturbance[2:4], start_disturbance[line:] = -acted.start_force, -1.0
    return LinearLaw(A_all, B_all, C_all, D_all, E, start_force, start_disturbance)
