"""The law `impedance`: a virtual spring to a point inside the surface."""

from __future__ import annotations

from multicontact_control.config import ForceConfig
from multicontact_control.force.linear_law import LinearLaw, LoopModel, sampled
import numpy as np


def design_impedance(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = omega^2 (alpha_des / k - z), z the way into the surface since the touch.

    At the touch z = alpha / k. Nothing integrates a force error away: the force is as exact as the
    stiffness k of the model and what is fed forward.

    Parameters
    ----------
    model
        What it is designed for.
    config
        Its gain is in `impedance`.

    """
    spring = config.impedance.natural_frequency ** 2
    return sampled(
        np.zeros((1, 1)), np.array([[0.0, 0.0, 1.0]]),
        np.array([[-spring], [0.0], [0.0]]),
        np.array([[0.0, spring / model.stiffness, 0.0], [1.0, 0.0, 0.0], [0.0] * 3]),
        model.period, start_force=np.array([1.0 / model.stiffness]))
