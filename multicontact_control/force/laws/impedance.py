"""The law `impedance`: a virtual spring to a point in the surface."""

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
    SPEED,
    U,
)


def design_impedance(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = omega^2 (alpha_des / k - z), z the way into the surface since the touch.

    At the touch z = alpha / k. Nothing integrates a force error away: the force is as exact as the
    stiffness k of the model and what is fed forward.
    """
    spring = config.impedance.natural_frequency**2
    depth = 0  # the only state: z
    law = make_zero_law(1)
    law.B[depth, SPEED] = 1.0
    law.C[U, depth] = -spring
    law.D[U, ALPHA_DES] = spring / model.stiffness
    law.D[ALPHA_EST, ALPHA_MEAS] = 1.0
    law.start_force[depth] = 1.0 / model.stiffness
    return discretise_law(law, model.period)


LAW = LawDesign(
    design_impedance,
    reads=('impedance',),
    speed_exponents={'impedance': {'natural_frequency': 1}},
)
