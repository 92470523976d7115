"""The law `admittance`: force errors move a virtual mass, whose speed is followed."""

from __future__ import annotations

from multicontact_control.config import ForceConfig
from multicontact_control.force.linear_law import LinearLaw, LoopModel, sampled
import numpy as np


def design_admittance(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = K_2 v_ref, with M dv/dt = e - D v and v_ref = v + K_i int e dt.

    The damping K_2 makes that a speed controller, u - K_2 v_contact. D = k / bandwidth.

    Parameters
    ----------
    model
        What it is designed for.
    config
        Its gains are in `admittance`.

    """
    values, K_2 = config.admittance, model.damping_rate
    compliance = values.bandwidth / model.stiffness  # 1 / D
    rate, integral = 1.0 / values.inertia_time, compliance * values.integral_rate
    extra = values.integral_rate / max(K_2, 1.0)  # per input, so that a limit does not wind it up
    return sampled(  # v, and K_i int e dt
        np.array([[-rate, 0.0], [0.0, 0.0]]),
        np.array([[-rate * compliance, rate * compliance, 0.0], [-integral, integral, 0.0]]),
        np.array([[K_2, K_2], [0.0, 0.0], [0.0, -K_2]]),
        np.array([[0.0] * 3, [1.0, 0.0, 0.0], [0.0] * 3]), model.period,
        E=np.array([0.0, extra]),
        start_disturbance=np.array([0.0, -1.0 / K_2 if K_2 else 0.0]))
