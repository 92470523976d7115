"""What is said in several places in the same way."""

from __future__ import annotations


def counted(number: int, what: str) -> str:
    """Return how many of something there are; `what` is its plural, that ends in s."""
    return f'{number} {what.removesuffix("s") if number == 1 else what}'


def lasting(seconds: float) -> str:
    """Return how long something takes, in the unit that suits it."""
    if seconds < 90.0:
        return f'{seconds:.0f} s'
    if seconds < 5400.0:
        return f'{seconds / 60.0:.1f} min'
    return f'{seconds / 3600.0:.1f} h'
