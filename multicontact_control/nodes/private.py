"""
What this package uses of rclpy (Jazzy) that is private there, and why: nothing public does it.

Another release of rclpy may need another way here, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.service import Service

__all__ = [
    'answer_later',
    'change_state_service',
    'parameter_overrides',
    'RCLError',
    'RcutilsLogger',
]
# RCLError is what a transition that is not possible now raises, RcutilsLogger what a node's
# `get_logger` returns: neither has a public name.


def parameter_overrides(node: Node) -> Mapping[str, Parameter]:
    """
    Return what the command line and its files set, None as the value of an empty list.

    Public ways tell nothing of a name that is not declared, and so hide a misspelt one.
    """
    overrides: Mapping[str, Parameter] = node._parameter_overrides
    return overrides


def change_state_service(node: LifecycleNode) -> Service:
    """
    Return the service that leads a node through its life cycle.

    A request for what is not possible now raises in it, which would end the node: its callback has
    to be wrapped.
    """
    return node._service_change_state


def answer_later(
    service: Service,
    take_in: Callable[[Any, Callable[[Any], None]], None],
) -> None:
    """
    Let requests of a service be answered when their callback has long returned.

    `take_in` is called with each request and with what sends a response to it. The events executor
    knows no coroutines as callbacks of services: it calls `callback`, then `send_response`.
    """
    send = service.send_response
    waiting: list[Any] = []  # the request of the callback that has run last, or none

    def keep_request(request: Any, response: Any) -> Any:
        waiting.append(request)
        return response

    def send_later(_response: Any, header: Any) -> None:
        take_in(waiting.pop(), partial(send, header=header))

    service.callback = keep_request
    service.send_response = send_later
