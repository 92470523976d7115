"""A thread beside that of a node, for work that takes longer than a sample may wait."""

from __future__ import annotations

from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
import os
from typing import Any, TypeVar

T = TypeVar('T')
# Yields where a sample may come between, and returns T.
Pausing = Generator[None, None, T]


class BackgroundThread:
    """
    Does the work of one caller after the other in one thread.

    The thread starts with the object, so that no sample waits for that. Generators wait for it by
    ``yield from``: the loop of the node answers samples in between.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, 'background')
        self._thread.submit(os.getpid)  # the first work starts the thread

    def compute(self, work: Callable[..., T], *arguments: Any) -> Pausing[Future[T]]:
        """
        Yield until the thread has done some work; return its outcome.

        `result` of the outcome returns what the work has returned, or raises what it has raised.
        """
        outcome = self._thread.submit(work, *arguments)
        while not outcome.done():
            yield
        return outcome
