"""The law `aob`: the active observer (P04 eqs 34-41)."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.config import ForceConfig
from multicontact_control.force.laws.design import LawDesign, LoopModel
from multicontact_control.force.laws.linear import (
    ALPHA_DES,
    ALPHA_EST,
    ALPHA_MEAS,
    LinearLaw,
    make_zero_law,
    P_EST,
    U,
)
from multicontact_control.force.observer import design_observer, ObserverDesign
from multicontact_control.force.plant import place_poles
import numpy as np


def design_aob(model: LoopModel, config: ForceConfig) -> ObserverDesign:
    """
    Design the active observer (P04 eqs 34-37, 41).

    The two poles of the force loop lie at -1 / `time_constant` and at `second_pole_ratio` times
    that; the Kalman gain is found on-line, from R.
    """
    loop = place_poles(
        model.plant,
        model.period,
        time_constant=config.time_constant,
        second_pole_ratio=config.second_pole_ratio,
    )
    return design_observer(
        loop, order=config.active_state_order, process_noise=config.process_noise
    )


def make_steady_law(observer: ObserverDesign, gain: Vector) -> LinearLaw:
    """
    Return an observer whose gain is constant as a linear law.

    Its state is the prediction x_1: u = L_1 alpha_des - [L_r 1] x_est with
    x_est = x_1 + K (alpha - C x_1), and the next prediction is
    Phi_c x_est + Gamma (L_1 alpha_des + extra) (P04 eqs 36-39).

    Parameters
    ----------
    observer
        An active observer of n states.
    gain
        K, shape (n,), as from `solve_steady_gain`.

    """
    n = len(observer.Gamma)
    newest_disturbance = n - observer.order
    L_1 = observer.feedback[0]
    correction = np.eye(n)  # of x_est by x_1: 1 - K C
    correction[:, 0] -= gain
    outputs = np.zeros((3, n))  # by x_est
    outputs[U] = -observer.feedback
    outputs[ALPHA_EST, 0] = 1.0

    law = make_zero_law(n)
    law.start_force[0] = 1.0
    if observer.order:
        outputs[P_EST, newest_disturbance] = 1.0
        law.start_disturbance[newest_disturbance:] = 1.0
    law.A[:] = observer.Phi_c @ correction
    law.B[:, ALPHA_MEAS] = observer.Phi_c @ gain
    law.B[:, ALPHA_DES] = L_1 * observer.Gamma
    law.C[:] = outputs @ correction
    law.D[:, ALPHA_MEAS] = outputs @ gain
    law.D[U, ALPHA_DES] = L_1
    law.E[:] = observer.Gamma
    return law


LAW = LawDesign(
    design_aob,
    reads=(
        'time_constant',
        'second_pole_ratio',
        'active_state_order',
        'process_noise',
    ),
    speed_exponents={'time_constant': -1},
)
