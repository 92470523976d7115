"""Parameters that change while a node works: a thread computes what takes long."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from multicontact_control.nodes.background import BackgroundThread
from multicontact_control.nodes.parameters import ParameterSet
from multicontact_control.nodes.private import answer_later
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter

NOTHING_LEFT = object()


class LiveChanges:
    """
    Answers requests to set parameters of a node, each once its change is in force or refused.

    What a change leads to takes longer than a sample may wait: a background
    thread computes it, one change
    after the other. `poll`, called by the node's loop, takes it over.
    """

    def __init__(
        self, node: Node, parameters: ParameterSet, background: BackgroundThread
    ) -> None:
        self._parameters, self._background = parameters, background
        self._requests: deque[Iterator[None]] = deque()
        for service in node.services:
            if service.srv_type is SetParameters:
                answer_later(service, self._take_one_by_one)
            elif service.srv_type is SetParametersAtomically:
                answer_later(service, self._take_at_once)

    def poll(self) -> None:
        """Take over what has been computed since, and answer."""
        while self._requests:
            if next(self._requests[0], NOTHING_LEFT) is not NOTHING_LEFT:
                return  # it waits for the thread
            self._requests.popleft()

    def _take_one_by_one(self, request: Any, answer: Callable[[Any], None]) -> None:
        changes = [[Parameter.from_parameter_msg(each)] for each in request.parameters]
        response = SetParameters.Response()
        self._requests.append(
            self._serve(changes, response.results, partial(answer, response))
        )

    def _take_at_once(self, request: Any, answer: Callable[[Any], None]) -> None:
        change = [Parameter.from_parameter_msg(each) for each in request.parameters]
        results: list[Any] = []
        self._requests.append(
            self._serve(
                [change],
                results,
                lambda: answer(SetParametersAtomically.Response(result=results[0])),
            )
        )

    def _serve(
        self,
        changes: Sequence[Sequence[Parameter]],
        results: Any,
        answer: Callable[[], None],
    ) -> Iterator[None]:
        """Yield while the thread computes; then change, and answer."""
        parameters = self._parameters
        for change in changes:
            version = None
            while version != parameters.version:  # another change has come first
                version = parameters.version
                designed = yield from self._background.compute(
                    parameters.design_change, change
                )
            results.append(parameters.apply(change, designed.result))
        answer()
