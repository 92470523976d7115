"""A node of the test's own, and other processes to talk to."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import subprocess
import sys
import time
from typing import TypeVar

from multicontact_control.nodes.link import GuestNode
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python

T = TypeVar('T')

ROOT = Path(__file__).resolve().parents[1]
# s, that any test waits for anything: so long that only what never comes is missed.
PATIENCE = float(os.environ.get('MULTICONTACT_TEST_PATIENCE', '180'))
END_TIMEOUT = 10.0  # s, for a node that is terminated after its test


def wait_for(
    condition: Callable[[], T], what: str, seen: Callable[[], object] | None = None,
) -> T:
    """
    Wait until a condition is true and return its value.

    A slow machine may make an event late, but may not cause its absence. That is an error which
    says what was `seen` instead, or else the condition's last value.
    """
    give_up = time.monotonic() + PATIENCE
    while not (value := condition()):
        if time.monotonic() > give_up:
            raise AssertionError(f'{what}: did not happen within {PATIENCE:g} s; '
                                 f'last seen: {value if seen is None else seen()!r}')
        time.sleep(0.005)
    return value


def end_of(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Wait for the end of a process; return what it wrote to its two pipes."""
    return process.communicate(timeout=PATIENCE)


class Middleware:
    """
    One node in the domain of the tests, and the processes that were started there.

    It goes by the name of the simulator, whose place it takes.
    """

    def __init__(self, domain_id: int) -> None:
        self._guest = GuestNode('sim_node', domain_id)
        self.node = self._guest.node
        self._processes: list[subprocess.Popen[str]] = []

    def __enter__(self) -> Middleware:
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._processes:
            process.terminate()  # nothing to one that has ended
        for process in self._processes:
            try:
                process.communicate(timeout=END_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
        self._guest.close()

    def start(
        self, module: str, *parameters: str, files: tuple[Path, ...] = (),
        flags: tuple[str, ...] = (),
    ):
        """Start a node of the project in a process of its own."""
        command = [sys.executable, '-m', module, *flags, '--ros-args']
        for path in files:
            command += ['--params-file', str(path)]
        for parameter in parameters:
            command += ['-p', parameter]
        environment = dict(os.environ)
        environment['PYTHONPATH'] = os.pathsep.join(
            filter(None, [str(ROOT), environment.get('PYTHONPATH')]))
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self._processes.append(process)
        return process

    def pause(self, duration: float = 0.002) -> None:
        """Give the others some time."""
        time.sleep(duration)

    def take(self, subscription, message):
        """Return the newest message of a subscription, None without any."""
        newest = None
        handle = subscription.handle
        with handle:
            while (taken := handle.take_message(message, False)) is not None:
                newest = taken[0]
        return newest


def set_parameter(driver, node_name, name, value):
    """Set a parameter of a node as `ros2 param set` does; return the result."""
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return driver.call(node_name, SetParameters, 'set_parameters', request).results[0]


def get_parameter(driver, node_name, name):
    """Return the value of a parameter of a node."""
    answer = driver.call(
        node_name, GetParameters, 'get_parameters', GetParameters.Request(names=[name]))
    value = parameter_value_to_python(answer.values[0])
    return value if value is None or isinstance(value, (bool, int, float, str)) else list(value)
