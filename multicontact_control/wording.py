"""What is said in several places in the same way."""

from __future__ import annotations


def counted(number: int, what: str) -> str:
    """Return how many of something there are; `what` is its plural, that ends in s."""
    return f'{number} {what.removesuffix("s") if number == 1 else what}'
