"""What the nodes of one process hand each other without the middleware."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

Callback = Callable[[bytes], None]


class LocalDelivery:
    """
    Messages on their way from one node of this process to another.

    They wait in the order in which they were sent, and are delivered when the process has nothing
    else to do, as an executor would: who sends is never called back from within.

    Parameters
    ----------
    members
        Names of the nodes in this process.

    """

    def __init__(self, members: Iterable[str] = ()) -> None:
        self.members = frozenset(members)
        self._readers: dict[str, list[LocalSubscription]] = {}
        self._waiting: deque[tuple[Callback, bytes]] = deque()

    def subscribe(self, topic_name: str, callback: Callback) -> LocalSubscription:
        """Call back with every message of a topic, given by its full name, from now on."""
        subscription = LocalSubscription(self, topic_name, callback)
        self._readers.setdefault(topic_name, []).append(subscription)
        return subscription

    def unsubscribe(self, subscription: LocalSubscription) -> None:
        """Deliver nothing more to a subscription."""
        self._readers[subscription.topic_name].remove(subscription)

    def readers(self, topic_name: str) -> int:
        """Return how many read a topic."""
        return len(self._readers.get(topic_name, ()))

    def send(self, topic_name: str, data: bytes) -> None:
        """Put a message on its way to all that read the topic."""
        for reader in self._readers.get(topic_name, ()):
            self._waiting.append((reader.callback, data))

    def deliver(self) -> bool:
        """Call back for all that waits, and for what is sent meanwhile; return whether any did."""
        waiting = self._waiting
        if not waiting:
            return False
        while waiting:
            callback, data = waiting.popleft()
            callback(data)
        return True


class LocalSubscription:
    """The end of a topic within the process, as far as it is asked what rclpy's is asked."""

    def __init__(self, delivery: LocalDelivery, topic_name: str, callback: Callback) -> None:
        self._delivery = delivery
        self.topic_name, self.callback = topic_name, callback

    def get_publisher_count(self) -> int:
        """Return 1: who publishes is in this process."""
        return 1

    def close(self) -> None:
        """Read nothing more."""
        self._delivery.unsubscribe(self)
