"""Butterworth low-passes, as `scipy.signal.butter` gives them, whose import takes 0.7 s."""

from __future__ import annotations

from multicontact_control.arrays import Vector
import numpy as np


def butterworth(order: int, cutoff: float, rate: float) -> tuple[Vector, Vector]:
    """
    Return numerator and denominator of a low-pass, highest power of z first.

    Parameters
    ----------
    order
        Number of poles.
    cutoff, rate
        Frequency of -3 dB, and that of the samples, more than twice as high [Hz].

    """
    fs2 = 4.0  # twice the rate at which a Nyquist frequency is 1
    warped = fs2 * np.tan(0.5 * np.pi * (2.0 * cutoff / rate))
    poles = -warped * np.exp(0.5j * np.pi * np.arange(1 - order, order, 2) / order)
    gain = warped ** order * np.real(1.0 / np.prod(fs2 - poles))
    return (gain * np.poly(-np.ones(order)),
            np.real(np.poly((fs2 + poles) / (fs2 - poles))))
