"""The law `pi`: proportional and integral, on a measured force that may be low-passed."""

from __future__ import annotations

import math

from multicontact_control.config import ForceConfig
from multicontact_control.force.linear_law import LinearLaw, LoopModel, sampled
import numpy as np


def design_pi(model: LoopModel, config: ForceConfig) -> LinearLaw:
    """
    Design u = K_p e + K_i int e dt with e = alpha_des - alpha, alpha low-passed.

    K_p = bandwidth K_2 / k gives the loop that bandwidth on a surface of the stiffness k. What
    acts beyond u is integrated at the same rate, so that a limit does not wind the integral up.

    Parameters
    ----------
    model
        What it is designed for.
    config
        Its gains are in `pi`.

    """
    pi = config.pi
    gain = pi.bandwidth * model.damping_rate / model.stiffness
    integral = gain * pi.integral_rate
    if not pi.filter_cutoff:  # int e dt alone
        return sampled(
            np.zeros((1, 1)), np.array([[-integral, integral, 0.0]]),
            np.array([[1.0], [0.0], [-1.0]]),
            np.array([[-gain, gain, 0.0], [1.0, 0.0, 0.0], [0.0] * 3]), model.period,
            E=np.array([pi.integral_rate]), start_disturbance=np.array([-1.0]))
    cutoff = 2.0 * math.pi * pi.filter_cutoff
    return sampled(  # low-passed alpha, and K_i int e dt
        np.array([[-cutoff, 0.0], [-integral, 0.0]]),
        np.array([[cutoff, 0.0, 0.0], [0.0, integral, 0.0]]),
        np.array([[-gain, 1.0], [1.0, 0.0], [0.0, -1.0]]),
        np.array([[0.0, gain, 0.0], [0.0] * 3, [0.0] * 3]), model.period,
        E=np.array([0.0, pi.integral_rate]), start_force=np.array([1.0, 0.0]),
        start_disturbance=np.array([0.0, -1.0]))
