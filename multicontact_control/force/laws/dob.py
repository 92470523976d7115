"""The law `dob`: a proportional gain around a disturbance observer."""

from __future__ import annotations

from multicontact_control.config import ForceConfig
from multicontact_control.force.laws.design import LawDesign, LoopModel
from multicontact_control.force.laws.linear import (
    ALPHA_DES,
    ALPHA_EST,
    ALPHA_MEAS,
    discretise_law,
    LinearLaw,
    make_zero_law,
    P_EST,
    U,
)
import numpy as np


def design_dob(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = K_p (alpha_des - alpha) - d with d = Q (G_n^-1 alpha - e^(-s T_d) u).

    G_n = k / (s (s + K_2)) is the nominal plant and Q = omega^2 / (s + omega)^2. The inputs under
    way are kept in whole periods, at least one.
    """
    omega = config.dob.observer_bandwidth
    K_2 = model.damping_rate
    k = model.stiffness
    gain = config.dob.bandwidth * K_2 / k

    # Q in controllable form: of its state, s (s + K_2) / k makes Q G_n^-1 alpha.
    inverse_filter = _low_pass(omega)
    inverse_filter.C[P_EST] = omega**2 / k * np.array([-(omega**2), K_2 - 2.0 * omega])
    inverse_filter.D[P_EST, ALPHA_MEAS] = omega**2 / k
    inverse_plant = discretise_law(inverse_filter, model.period)

    # Q u, with u in the place of alpha.
    input_filter = _low_pass(omega)
    input_filter.C[P_EST] = [omega**2, 0.0]
    acted = discretise_law(input_filter, model.period)

    # The states: of Q G_n^-1 alpha, of Q u, and u of the last periods, oldest first.
    of_inverse = slice(0, 2)
    of_acted = slice(2, 4)
    oldest = 4
    newest = oldest + max(1, round(model.input_delay / model.period)) - 1
    law = make_zero_law(newest + 1)
    law.A[of_inverse, of_inverse] = inverse_plant.A
    law.B[of_inverse] = inverse_plant.B
    law.A[of_acted, of_acted] = acted.A
    law.A[of_acted, oldest] = acted.B[:, ALPHA_MEAS]
    for place in range(oldest, newest):
        law.A[place, place + 1] = 1.0
    law.C[P_EST, of_inverse] = inverse_plant.C[P_EST]
    law.C[P_EST, of_acted] = -acted.C[P_EST]
    law.C[P_EST, oldest] = -acted.D[P_EST, ALPHA_MEAS]
    law.D[P_EST] = inverse_plant.D[P_EST]
    law.D[ALPHA_EST, ALPHA_MEAS] = 1.0
    law.D[U, ALPHA_MEAS] = -gain
    law.D[U, ALPHA_DES] = gain
    law.C[U] = -law.C[P_EST]
    law.D[U] -= law.D[P_EST]
    law.A[newest] = law.C[U]
    law.B[newest] = law.D[U]
    law.E[newest] = 1.0
    law.start_force[of_inverse] = inverse_plant.start_force
    law.start_disturbance[of_acted] = -acted.start_force
    law.start_disturbance[oldest:] = -1.0
    return law


def _low_pass(omega: float) -> LinearLaw:
    """Return Q of alpha, which starts at the rest of an input of 1, without an output."""
    law = make_zero_law(2)
    law.A[:] = [[0.0, 1.0], [-(omega**2), -2.0 * omega]]
    law.B[1, ALPHA_MEAS] = 1.0
    law.start_force[0] = 1.0 / omega**2
    return law


LAW = LawDesign(
    design_dob,
    reads=('dob',),
    speed_exponents={'dob': {'bandwidth': 1, 'observer_bandwidth': 1}},
)
