"""The law `lqg`: the model of the active observer with constant optimal gains."""

from __future__ import annotations

from multicontact_control.config import ForceConfig
from multicontact_control.force.laws.aob import make_steady_law
from multicontact_control.force.laws.design import LawDesign, LoopModel
from multicontact_control.force.laws.linear import LinearLaw
from multicontact_control.force.observer import design_observer, solve_steady_gain
from multicontact_control.force.plant import ForceLoop
import numpy as np
from scipy.linalg import solve_discrete_are


def design_lqg(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design the AOB's model with constant gains, both from Riccati equations.

    The filter settles at R = `noise_variance`; the feedback minimises sum alpha^2 + rho u^2.
    """
    Phi = model.plant.Phi
    Gamma = model.plant.Gamma[:, None]
    force_weight = np.zeros_like(Phi)
    force_weight[0, 0] = 1.0
    rho = config.lqg.input_weight
    S = solve_discrete_are(Phi, Gamma, force_weight, np.array([[rho]]))
    L = (Gamma.T @ S @ Phi / (rho + Gamma.T @ S @ Gamma))[0]
    observer = design_observer(
        ForceLoop(model.plant, L), process_noise=config.process_noise
    )
    return make_steady_law(
        observer, solve_steady_gain(observer, config.lqg.noise_variance)
    )


LAW = LawDesign(
    design_lqg,
    reads=('lqg', 'process_noise'),
    speed_exponents={'lqg': {'input_weight': -2}},
    noise_gain=('lqg', 'noise_variance'),
)
