"""Parameters that change while a node works: a thread computes what takes long."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from multicontact_control.nodes.background import BackgroundThread, Pausing
from multicontact_control.nodes.parameters import ParameterSet
from multicontact_control.nodes.private import answer_later
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter

NOTHING_LEFT = object()
SendResponse = Callable[[Any], None]


class LiveChanges:
    """
    Answers requests to set parameters of a node, each once its change is in force or refused.

    What a change leads to takes longer than a sample may wait: a background thread computes it,
    one change after the other. `poll`, called by the node's loop, takes it over.
    """

    def __init__(
        self, node: Node, parameters: ParameterSet, background: BackgroundThread
    ) -> None:
        self._parameters = parameters
        self._background = background
        self._requests: deque[Iterator[None]] = deque()
        for service in node.services:
            if service.srv_type is SetParameters:
                answer_later(service, partial(self._queue, self._change_singly))
            elif service.srv_type is SetParametersAtomically:
                answer_later(service, partial(self._queue, self._change_jointly))

    def poll(self) -> None:
        """Put into force what has been computed since the last call, and answer."""
        while self._requests:
            if next(self._requests[0], NOTHING_LEFT) is not NOTHING_LEFT:
                return  # it waits for the thread
            self._requests.popleft()

    def _queue(
        self,
        change: Callable[[Any, SendResponse], Iterator[None]],
        request: Any,
        send_response: SendResponse,
    ) -> None:
        self._requests.append(change(request, send_response))

    def _change_singly(
        self, request: Any, send_response: SendResponse
    ) -> Iterator[None]:
        """Change each parameter for itself: some may be refused."""
        response = SetParameters.Response()
        for message in request.parameters:
            change = [Parameter.from_parameter_msg(message)]
            response.results.append((yield from self._apply_change(change)))
        send_response(response)

    def _change_jointly(
        self, request: Any, send_response: SendResponse
    ) -> Iterator[None]:
        """Change all parameters or none."""
        change = [Parameter.from_parameter_msg(each) for each in request.parameters]
        result = yield from self._apply_change(change)
        send_response(SetParametersAtomically.Response(result=result))

    def _apply_change(
        self, change: Sequence[Parameter]
    ) -> Pausing[SetParametersResult]:
        """Yield while the thread computes; then change, and return whether that was possible."""
        parameters = self._parameters
        version = None
        while version != parameters.version:  # else another change has come first
            version = parameters.version
            designed = yield from self._background.compute(
                parameters.design_change, change
            )
        return parameters.apply(change, designed.result)
