"""Several nodes in one process, which run in turn and hand each other their messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from multicontact_control.nodes.local_delivery import LocalDelivery


class Composition:
    """
    A node that has the process, and others that run whenever it waits.

    All of them are of one thread: two would take Python's lock from each other, and whoever needs
    an answer waits for it anyway.

    Parameters
    ----------
    main
        The node whose `run` is run; its end is that of all.
    passengers
        The others: managed nodes.
    local
        What hands messages from one to the other.

    Attributes
    ----------
    members
        All nodes.

    """

    def __init__(
        self, main: Any, passengers: Sequence[Any] = (), local: LocalDelivery | None = None,
    ) -> None:
        self.members = (main, *passengers)
        self._main, self._passengers = main, passengers
        self._local = local or LocalDelivery()
        self._in_turn = False

    def run(self, spinner: Any) -> None:
        """Run all nodes until the main one ends."""
        for node in self._passengers:
            node.begin()
        self._main.run(spinner)
        if self._passengers:
            spinner.drain()

    def longest_wait(self, timeout: float) -> float:
        """Return how long the process may wait if the main node would for a time [s]."""
        return min((timeout, *(node.longest_wait() for node in self._passengers)))

    def deliver(self) -> bool:
        """Deliver what waits within the process; return whether anything did."""
        return self._local.deliver()

    def take_turns(self, spinner: Any) -> None:
        """Let the passengers do what is due; they may spin, but not in circles."""
        if self._in_turn or not self._passengers:
            return
        self._in_turn = True
        try:
            for node in self._passengers:
                node.turn(spinner)
        finally:
            self._in_turn = False

    def close(self) -> None:
        """Close all nodes, the main one first, whatever becomes of each."""
        _close(self.members)


def _close(nodes: Sequence[Any]) -> None:
    if nodes:
        try:
            nodes[0].close()
        finally:
            try:
                _close(nodes[1:])
            finally:
                nodes[0].destroy_node()
