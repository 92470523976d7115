"""The law `admittance`: a virtual mass and damper make a speed of the force error."""

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


def design_admittance(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = K_2 v_ref, with M dv/dt = e - D v and v_ref = v + K_i int e dt.

    The damping K_2 makes that a speed controller, u - K_2 v_contact. D = k / bandwidth. What acts
    beyond u is taken off the integral, so that a limit does not wind it up.
    """
    K_2 = model.damping_rate
    compliance = config.admittance.bandwidth / model.stiffness  # 1 / D
    rate = 1.0 / config.admittance.inertia_time
    integral_gain = compliance * config.admittance.integral_rate
    speed, integral = range(2)  # the states: v, and K_i int e dt
    law = make_zero_law(2)
    law.A[speed, speed] = -rate
    law.B[speed, ALPHA_MEAS] = -rate * compliance
    law.B[speed, ALPHA_DES] = rate * compliance
    law.B[integral, ALPHA_MEAS] = -integral_gain
    law.B[integral, ALPHA_DES] = integral_gain
    law.C[U] = K_2
    law.C[P_EST, integral] = -K_2
    law.D[ALPHA_EST, ALPHA_MEAS] = 1.0
    law.E[integral] = config.admittance.integral_rate / max(K_2, 1.0)
    if K_2:
        law.start_disturbance[integral] = -1.0 / K_2
    return discretise_law(law, model.period)


LAW = LawDesign(
    design_admittance,
    reads=('admittance',),
    speed_exponents={'admittance': {'bandwidth': 1}},
)
