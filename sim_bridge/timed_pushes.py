"""Pushes that come and go at set times."""

from __future__ import annotations

from collections.abc import Sequence

from multicontact_control.arrays import Vector
import numpy as np


def push_at(
    tick: int, rate: float, start: Sequence[float], duration: Sequence[float],
    force_world: Sequence[float],
) -> Vector:
    """
    Return the sum of the pushes in the control period that begins with a tick.

    Parameters
    ----------
    tick
        The tick.
    rate
        Control rate [Hz].
    start, duration
        Of each push [s].
    force_world
        x y z of each in turn [N].

    Returns
    -------
    Vector
        World axes, shape (3,) [N].

    """
    total = np.zeros(3)
    for i, (begin, length) in enumerate(zip(start, duration, strict=True)):
        if round(begin * rate) <= tick < round((begin + length) * rate):
            total += force_world[3 * i:3 * i + 3]
    return total
