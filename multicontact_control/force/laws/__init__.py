"""The force laws, one module each, behind one registry."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from multicontact_control.config import ForceConfig
from multicontact_control.force.laws.admittance import design_admittance
from multicontact_control.force.laws.aob import design_aob, steady_law
from multicontact_control.force.laws.dob import design_dob
from multicontact_control.force.laws.feedforward import design_feedforward
from multicontact_control.force.laws.impedance import design_impedance
from multicontact_control.force.laws.lqg import design_lqg
from multicontact_control.force.laws.pi import design_pi
from multicontact_control.force.linear_law import LinearLaw, LoopModel
from multicontact_control.force.observer import ObserverDesign

__all__ = ['LAWS', 'LinearLaw', 'LoopModel', 'design_aob', 'steady_law']

Design = Callable[[LoopModel, ForceConfig], ObserverDesign | LinearLaw]

LAWS: Mapping[str, Design] = {
    'aob': design_aob, 'pi': design_pi, 'dob': design_dob, 'lqg': design_lqg,
    'admittance': design_admittance, 'impedance': design_impedance,
    'feedforward': design_feedforward}
