"""The force laws behind one registry, their margins, and gains for a range of stiffness."""

from multicontact_control.force.laws.designs import design_aob, LAWS, steady_law
from multicontact_control.force.linear_law import LinearLaw, LoopModel

__all__ = ['LAWS', 'LinearLaw', 'LoopModel', 'design_aob', 'steady_law']
