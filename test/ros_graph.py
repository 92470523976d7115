"""A node of the test's own, and other processes to talk to."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import subprocess
import sys
import time

from multicontact_control.nodes.runtime import prepare_environment
from rclpy.context import Context
from rclpy.node import Node

ROOT = Path(__file__).resolve().parents[1]
DEADLINE = 60.0


def wait_for(condition: Callable[[], object], what: str, *, deadline: float = DEADLINE) -> None:
    """Wait for an event; its absence is the only thing a slow machine may not cause."""
    give_up = time.monotonic() + deadline
    while not condition():
        if time.monotonic() > give_up:
            raise AssertionError(f'{what}: did not happen within {deadline:g} s')
        time.sleep(0.005)


class Middleware:
    """
    One node in the domain of the tests, and the processes that were started there.

    It goes by the name of the simulator, whose place it takes.
    """

    def __init__(self, domain_id: int) -> None:
        prepare_environment()
        self._context = Context()
        self._context.init(args=[], domain_id=domain_id)
        self.node = Node(
            'sim_node', context=self._context, use_global_arguments=False,
            start_parameter_services=False)
        self._processes: list[subprocess.Popen[str]] = []

    def __enter__(self) -> Middleware:
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._processes:
            if process.poll() is None:
                process.kill()
            process.communicate()
        self.node.destroy_node()
        self._context.try_shutdown()

    def start(self, module: str, *parameters: str, files: tuple[Path, ...] = ()):
        """Start a node of the project in a process of its own."""
        command = [sys.executable, '-m', module, '--ros-args']
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

    def take(self, subscription, message):
        """Return the newest message of a subscription, None without any."""
        newest = None
        handle = subscription.handle
        with handle:
            while (taken := handle.take_message(message, False)) is not None:
                newest = taken[0]
        return newest
