"""The law `lqg`: a steady Kalman filter with a disturbance state, and an LQ regulator."""

from __future__ import annotations

from multicontact_control.config import ForceConfig
from multicontact_control.force.laws.aob import steady_law
from multicontact_control.force.linear_law import LinearLaw, LoopModel
from multicontact_control.force.linear_loop import steady_gain
from multicontact_control.force.observer import design_observer
from multicontact_control.force.plant_model import ForceLoop
import numpy as np
from scipy.linalg import solve_discrete_are


def design_lqg(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design the AOB's model with constant gains, both from Riccati equations.

    The filter settles at R = `noise_variance`; the feedback minimises sum alpha^2 + rho u^2.

    Parameters
    ----------
    model
        What it is designed for.
    config
        Its weights are in `lqg`; `process_noise` is that of all observers.

    """
    Phi, Gamma = model.plant.Phi, model.plant.Gamma[:, None]
    weight = np.zeros_like(Phi)
    weight[0, 0] = 1.0
    rho = config.lqg.input_weight
    S = solve_discrete_are(Phi, Gamma, weight, np.array([[rho]]))
    L = (Gamma.T @ S @ Phi / (rho + Gamma.T @ S @ Gamma))[0]
    observer = design_observer(ForceLoop(model.plant, L), process_noise=config.process_noise)
    return steady_law(observer, steady_gain(observer, config.lqg.noise_variance))
