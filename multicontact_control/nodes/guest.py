"""A node of a process that is none of the graph's: a command, a client, a campaign."""

from __future__ import annotations

import threading

from multicontact_control.nodes.runtime import prepare_environment
from rclpy.context import Context
from rclpy.node import Node

_lock = threading.Lock()
_shared: dict[int | None, list[Node]] = {}


class GuestNode:
    """
    A node without parameters and logs, in a context that all guests of a domain share.

    A context is a participant of DDS as long as it has a node. Fast DDS 2.14 can wait for itself
    for ever when a participant leaves while others come and go, so that a process has one, which
    leaves with its last guest.

    Parameters
    ----------
    name, namespace
        Of the node.
    domain_id
        ROS domain; that of the environment by default.

    Attributes
    ----------
    context, node
        What rclpy calls so.

    """

    def __init__(self, name: str, domain_id: int | None = None, namespace: str = '') -> None:
        prepare_environment()
        self._domain_id = domain_id
        with _lock:
            guests = _shared.setdefault(domain_id, [])
            if guests:
                self.context = guests[0].context
            else:
                self.context = Context()
                self.context.init(args=[], domain_id=domain_id)
            self.node = Node(
                name, namespace=namespace, context=self.context, use_global_arguments=False,
                start_parameter_services=False, enable_rosout=False)
            guests.append(self.node)

    def close(self) -> None:
        """Leave the graph."""
        with _lock:
            guests = _shared[self._domain_id]
            guests.remove(self.node)
            self.node.destroy_node()
            if not guests:
                self.context.try_shutdown()
