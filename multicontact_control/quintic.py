"""A path from 0 to 1 without a jump of speed or acceleration at its ends."""

from __future__ import annotations


def quintic(elapsed: float, duration: float) -> tuple[float, float, float]:
    """Return 10 x^3 - 15 x^4 + 6 x^5 of x = elapsed / duration, its speed and acceleration."""
    if elapsed >= duration:
        return 1.0, 0.0, 0.0
    x = max(0.0, elapsed / duration)
    return (x ** 3 * (10.0 + x * (-15.0 + 6.0 * x)),
            30.0 * x ** 2 * (1.0 - x) ** 2 / duration,
            60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / duration ** 2)
