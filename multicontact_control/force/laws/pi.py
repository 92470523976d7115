"""The law `pi`: a proportional and an integral gain on the force error."""

from __future__ import annotations

import math

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


def design_pi(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = K_p e + K_i int e dt with e = alpha_des - alpha, alpha low-passed.

    K_p = bandwidth K_2 / k gives the loop that bandwidth on a surface of the stiffness k. What
    acts beyond u is integrated at the same rate, so that a limit does not wind the integral up.
    """
    gain = config.pi.bandwidth * model.damping_rate / model.stiffness
    integral_gain = gain * config.pi.integral_rate
    is_filtered = config.pi.filter_cutoff > 0.0
    if is_filtered:
        filtered, integral = range(2)  # the states: low-passed alpha, and K_i int e dt
        law = make_zero_law(2)
        cutoff = 2.0 * math.pi * config.pi.filter_cutoff
        law.A[filtered, filtered] = -cutoff
        law.B[filtered, ALPHA_MEAS] = cutoff
        law.A[integral, filtered] = -integral_gain
        law.C[U, filtered] = -gain
        law.C[ALPHA_EST, filtered] = 1.0
        law.start_force[filtered] = 1.0
    else:
        integral = 0
        law = make_zero_law(1)
        law.B[integral, ALPHA_MEAS] = -integral_gain
        law.D[U, ALPHA_MEAS] = -gain
        law.D[ALPHA_EST, ALPHA_MEAS] = 1.0
    law.B[integral, ALPHA_DES] = integral_gain
    law.C[U, integral] = 1.0
    law.C[P_EST, integral] = -1.0
    law.D[U, ALPHA_DES] = gain
    law.E[integral] = config.pi.integral_rate
    law.start_disturbance[integral] = -1.0
    return discretise_law(law, model.period)


LAW = LawDesign(design_pi, reads=('pi',), speed_exponents={'pi': {'bandwidth': 1}})
