"""The law `feedforward`: no feedback of the force."""

from __future__ import annotations

from multicontact_control.config import ForceConfig
from multicontact_control.force.laws.design import LawDesign, LoopModel
from multicontact_control.force.laws.linear import (
    ALPHA_EST,
    ALPHA_MEAS,
    LinearLaw,
    make_zero_law,
)


def design_feedforward(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """Design u = 0: what is fed forward, and the damping K_2, are all that acts."""
    law = make_zero_law(0)
    law.D[ALPHA_EST, ALPHA_MEAS] = 1.0
    return law


LAW = LawDesign(design_feedforward, reads=(), speed_exponents={})
