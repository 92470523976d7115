"""The law `aob`: the paper's active observer, and what it is once its gain has settled."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.config import ForceConfig
from multicontact_control.force.linear_law import LinearLaw, LoopModel
from multicontact_control.force.observer import design_observer, ObserverDesign
from multicontact_control.force.plant_model import place_poles
import numpy as np


def design_aob(model: LoopModel, config: ForceConfig) -> ObserverDesign:
    """
    Design the active observer (P04 eqs 34-37, 41).

    Parameters
    ----------
    model
        What it is designed for.
    config
        Poles, active state and covariances.

    """
    loop = place_poles(model.plant, model.period, time_constant=config.time_constant,
                       second_pole_ratio=config.second_pole_ratio)
    return design_observer(
        loop, order=config.active_state_order, process_noise=config.process_noise,
        initial_covariance=config.initial_covariance)


def steady_law(observer: ObserverDesign, gain: Vector) -> LinearLaw:
    """
    Return an observer whose gain no longer changes as a linear law, its state the prediction x_1.

    u = L_1 alpha_des - [L_r 1] x_est with x_est = x_1 + K (alpha - C x_1), and the next
    prediction is Phi_c x_est + Gamma (L_1 alpha_des + extra) (P04 eqs 36-39).

    Parameters
    ----------
    observer
        Its design.
    gain
        K, shape (n,), as from `steady_gain`.

    """
    n = len(observer.Gamma)
    correction = np.eye(n)
    correction[:, 0] -= gain
    outputs = np.zeros((3, n))  # of x_est
    outputs[0], outputs[1, 0] = -observer.feedback, 1.0
    if observer.order:
        outputs[2, n - observer.order] = 1.0
    L_1 = observer.feedback[0]
    B, D = np.zeros((n, 3)), np.zeros((3, 3))
    B[:, 0], B[:, 1] = observer.Phi_c @ gain, L_1 * observer.Gamma
    D[:, 0], D[0, 1] = outputs @ gain, L_1
    start_force, start_disturbance = np.zeros(n), np.zeros(n)
    start_force[0] = 1.0
    if observer.order:
        start_disturbance[n - observer.order:] = 1.0
    return LinearLaw(observer.Phi_c @ correction, B, outputs @ correction, D, observer.Gamma,
                     start_force, start_disturbance)
