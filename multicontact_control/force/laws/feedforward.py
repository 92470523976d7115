"""The law `feedforward`: no feedback of the force, as a torque from inverse dynamics has none."""

from __future__ import annotations

from multicontact_control.config import ForceConfig
from multicontact_control.force.linear_law import LinearLaw, LoopModel
import numpy as np


def design_feedforward(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """Return u = 0: what is fed forward, and the damping K_2, are all that acts."""
    nothing = np.zeros((3, 3))
    nothing[1, 0] = 1.0  # alpha_est = alpha
    none = np.zeros(0)
    return LinearLaw(
        np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((3, 0)), nothing, none, none, none)
