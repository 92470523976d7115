"""
A node between the simulator and the controller that passes messages on, unless told otherwise.

Its parameter `fault` says what to do to which input: ``INPUT KIND SEED``, e.g. ``wrench nan 7``;
empty for nothing. The controller's inputs have to be remapped to its outputs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import sys
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.faults.graph_streams import (
    CLOCK,
    HISTORY,
    INPUTS,
    Pass,
    stream_faults,
    StreamContext,
)
from multicontact_control.nodes import messages, qos
from multicontact_control.nodes.graph_node import StartupConfig
from multicontact_control.nodes.parameters import load_parameters
from multicontact_control.nodes.runtime import run_node, Spinner
import numpy as np
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message

RELAY = 'fault_relay'
PARAMETER = 'fault'
PREFIX = 'faulty'


def outgoing(topic_name: str) -> str:
    """Return the name of the topic that a topic is passed on to."""
    return f'{PREFIX}/{topic_name}'


class FaultRelay(Node):
    """Passes on the inputs of the controller, byte by byte where no fault is on."""

    def __init__(self) -> None:
        super().__init__(RELAY)
        load_parameters(self, StartupConfig)
        self._faults = stream_faults()
        self._active: dict[str, tuple[Pass, StreamContext]] = {}
        self._passed: dict[str, int] = {}
        self._history: dict[str, deque[bytes]] = {
            source: deque(maxlen=HISTORY) for source in INPUTS}
        self._outputs = {source: self.create_publisher(
            topic.message, outgoing(topic.name), topic.profile)
            for source, topic in INPUTS.items()}
        for source, topic in INPUTS.items():
            self.create_subscription(
                topic.message, topic.name, self._passing(source), qos.INPUT, raw=True)
        self.declare_parameter(PARAMETER, '', ParameterDescriptor(
            description='INPUT KIND SEED of the fault that is on; empty for none.'))
        self.add_on_set_parameters_callback(self._on_parameters)

    def run(self, spinner: Spinner) -> None:
        """Pass messages on until asked to stop."""
        while not spinner.stop:
            spinner.spin_once()

    def close(self) -> None:
        """Nothing is left to write."""

    def _passing(self, source: str) -> Callable[[bytes], None]:
        history, publisher = self._history[source], self._outputs[source]

        def passed(data: bytes) -> None:
            history.append(data)
            fault = self._active.get(source)
            if fault is None:
                publisher.publish(data)
                return
            what, context = fault
            if context.first is None:
                context.first = data
            n = self._passed[source]
            self._passed[source] = n + 1
            for changed in what(context, n, data):
                publisher.publish(changed)
        return passed

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == PARAMETER:
                try:
                    self._begin(str(parameter.value))
                except ConfigError as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _begin(self, text: str) -> None:
        """
        Begin a fault, or end the one that is on.

        Raises
        ------
        ConfigError
            If there is no such fault.

        """
        if not text:
            self._active = {}
            return
        try:
            source, kind, seed = text.split()
            what, random = self._faults[source][kind], np.random.default_rng(int(seed))
        except (KeyError, ValueError):
            known = '; '.join(f'{x}: {", ".join(kinds)}' for x, kinds in self._faults.items())
            raise ConfigError(PARAMETER, f'INPUT KIND SEED ({known})', f"'{text}'") from None
        sources = ('joints', 'wrench') if source == CLOCK else (source,)
        begin = max(self._newest_stamp(x) for x in sources)
        choice = random.random(4).tolist()
        self._passed = dict.fromkeys(INPUTS, 0)
        self._active = {x: (what, StreamContext(
            random, INPUTS[x].message, self._history[x], begin, choice, [])) for x in sources}

    def _newest_stamp(self, source: str) -> int:
        if not self._history[source]:
            return 0
        newest: Any = deserialize_message(self._history[source][-1], INPUTS[source].message)
        return messages.stamp_to_ns(newest.header.stamp)


def main() -> int:
    """Run the relay."""
    return run_node(FaultRelay)


if __name__ == '__main__':
    sys.exit(main())
