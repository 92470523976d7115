"""A thread beside that of a node, for what no sample is to wait for."""

from __future__ import annotations

from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar('T')
Pausing = Generator[
    None, None, T
]  # yields where a sample may come between, and returns T


class BackgroundThread:
    """Does one thing after the other, in a thread that waits for them from the first on."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, 'helper')
        self._thread.submit(
            lambda: None
        )  # it starts here, and no sample waits for that

    def compute(self, work: Callable[..., T], *arguments: Any) -> Pausing[Future[T]]:
        """Yield until the thread has done some work; return its outcome."""
        outcome = self._thread.submit(work, *arguments)
        while not outcome.done():
            yield
        return outcome
