"""
A node between the simulator and the controller that passes messages on, unless told otherwise.

Its parameter `fault` says what to do to which input: ``INPUT KIND SEED``, e.g. ``wrench nan 7``;
empty for nothing. The controller's inputs have to be remapped to its outputs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
import sys
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.faults.fault import (
    ClockShift,
    Delivery,
    Edit,
    Fault,
    GRAPH,
    Random,
)
from multicontact_control.experiment.faults.vocabulary import CLOCK, faults_of, PERIOD, STREAMS
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph_node import StartupConfig
from multicontact_control.nodes.parameters import load_parameters
from multicontact_control.nodes.runtime import run_node, Spinner
import numpy as np
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message

RELAY = 'fault_relay'
PARAMETER = 'fault'
PREFIX = 'faulty'
HISTORY = 512  # messages: a second at 500 Hz, twice the longest fault
INPUTS: Mapping[str, topics.Topic] = {
    'joints': topics.JOINT_STATES, 'wrench': topics.WRENCH, 'variance': topics.NOISE_VARIANCE}
FIELDS = {'q': 'position', 'qd': 'velocity', 'names': 'name', 'variance': 'effort'}


def outgoing(topic_name: str) -> str:
    """Return the name of the topic that a topic is passed on to."""
    return f'{PREFIX}/{topic_name}'


def stream_faults() -> dict[tuple[str, str], Fault]:
    """Return the faults of messages on their way, by kind and input."""
    return {name: fault for name, fault in faults_of(GRAPH).items()
            if fault.input in (*STREAMS, CLOCK)}


class Distortion:
    """
    What a fault does to the messages of one topic.

    Parameters
    ----------
    fault, random
        Which, and the source of its details.
    message
        Class of the messages.
    history
        The good messages, serialised, newest last; that which is being passed on is in it.
    begin
        When the fault began, the same for all topics [ns].

    """

    def __init__(
        self, fault: Fault, random: Random, message: Any, history: deque[bytes], begin: int,
    ) -> None:
        self._action, self._message, self._history = fault.action, message, history
        self._begin, self._random, self._choice = begin, random, random.random(4)
        self._first: dict[str, Any] = {}
        self._passed = 0

    def passed_on(self, data: bytes) -> list[bytes]:
        """Return what is passed on when a message comes."""
        n, action = self._passed, self._action
        self._passed += 1
        if isinstance(action, Delivery):
            last = len(self._history) - 1
            return [self._history[max(0, last - age)] for age in action.ages(self._random, n)]
        message = deserialize_message(data, self._message)
        if isinstance(action, Edit):
            now = {name: read_field(message, name) for name in action.fields}
            self._first = self._first or now
            for name, values in action.values(now, self._first, self._choice).items():
                _write_field(message, name, values)
        elif isinstance(action, ClockShift):
            self._shift(message, action)
        return [serialize_message(message)]

    def _shift(self, message: Any, clock: ClockShift) -> None:
        stamp = messages.stamp_to_ns(message.header.stamp)
        shift = clock.shift(1e-9 * (stamp - self._begin), 1e-9 * self._begin)
        message.header.stamp = messages.ns_to_stamp(stamp + round(max(-stamp, 1e9 * shift)))


def read_field(message: Any, name: str) -> Any:
    """Return a field of a reading from its message."""
    if name == 'wrench':
        force, torque = message.wrench.force, message.wrench.torque
        return np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])
    values = getattr(message, FIELDS[name])
    return list(values) if name == 'names' else np.array(values)


def _write_field(message: Any, name: str, values: Any) -> None:
    """Put a field of a reading into its message."""
    if name == 'wrench':
        force, torque = message.wrench.force, message.wrench.torque
        force.x, force.y, force.z, torque.x, torque.y, torque.z = values.tolist()
    else:
        setattr(message, FIELDS[name], list(values))


class FaultRelay(Node):
    """Passes on the inputs of the controller, byte by byte where no fault is on."""

    def __init__(self) -> None:
        super().__init__(RELAY)
        load_parameters(self, StartupConfig)
        self._active: dict[str, Distortion] = {}
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
            distortion = self._active.get(source)
            for out in [data] if distortion is None else distortion.passed_on(data):
                publisher.publish(out)
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
        faults = stream_faults()
        try:
            source, kind, seed = text.split()
            fault, random = faults[kind, source], np.random.default_rng(int(seed))
        except (KeyError, ValueError):
            known = '; '.join(
                f'{name}: {", ".join(kind for kind, source in faults if source == name)}'
                for name in (*STREAMS, CLOCK))
            raise ConfigError(PARAMETER, f'INPUT KIND SEED ({known})', f"'{text}'") from None
        sources = ('joints', 'wrench') if source == CLOCK else (source,)
        begin = max(map(self._newest_stamp, sources)) + round(1e9 * PERIOD)
        self._active = {x: Distortion(fault, random, INPUTS[x].message, self._history[x], begin)
                        for x in sources}

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
