"""A sinusoid that is blended in."""

from __future__ import annotations

import math

from multicontact_control.control.reference.scenario_config import SineConfig


def sine_motion(config: SineConfig, time: float) -> tuple[float, float, float]:
    """
    Return displacement, speed and acceleration of the blended sinusoid.

    s = A b(tau / t_b) sin(2 pi tau / T), b the quintic 10 x^3 - 15 x^4 + 6 x^5.

    Parameters
    ----------
    config
        Amplitude A, period T, blend time t_b, start.
    time
        Scenario time [s].

    Returns
    -------
    tuple
        [m], [m/s], [m/s^2].

    """
    tau = time - config.start_time
    if tau <= 0.0:
        return 0.0, 0.0, 0.0
    w = 2.0 * math.pi / config.period
    sine, cosine = math.sin(w * tau), math.cos(w * tau)
    x = tau / config.blend_time
    if x >= 1.0:
        b, db, ddb = 1.0, 0.0, 0.0
    else:
        b = x ** 3 * (10.0 + x * (-15.0 + 6.0 * x))
        db = 30.0 * x ** 2 * (1.0 - x) ** 2 / config.blend_time
        ddb = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / config.blend_time ** 2
    A = config.amplitude
    return (A * b * sine, A * (db * sine + b * w * cosine),
            A * (ddb * sine + 2.0 * db * w * cosine - b * w * w * sine))
