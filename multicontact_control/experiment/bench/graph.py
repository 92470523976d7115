"""
The ROS 2 graph: lockstep factor, latency against a bare echo, what the recorder takes.

The floor of the latency is two bare rclpy processes that echo the same two messages; this module
is the other one.
"""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.errors import RunError
from multicontact_control.experiment.bench.timing import rounded_percentiles
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.run import GraphSpec, run_graph
from multicontact_control.experiment.scenario import resolve
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.graph_node import create_publisher, create_subscription
from multicontact_control.nodes.runtime import make_executor, start_ros
import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState

NAMES = tuple(f'joint{i + 1}' for i in range(6))
START_TIMEOUT, ANSWER_TIMEOUT = 20.0, 1.0


def bench_graph(duration: float) -> dict[str, Any]:
    """Run the graph in lockstep and in real time [s], and the echo with the same period."""
    with TemporaryDirectory() as name:
        lockstep = _run(Path(name) / 'lockstep', duration, lockstep=True)
        real_time = _run(Path(name) / 'real_time', duration, lockstep=False)
    with reserve_domain(None) as domain_id:
        os.environ['ROS_DOMAIN_ID'] = str(domain_id)
        echo = rounded_percentiles(echo_latency(int(500 * duration), 1.0 / 500.0))
    latency = real_time['sim_node']['latency_us']
    recorder = real_time['recorder_node']
    wall = real_time['sim_node']['wall_s']
    return {
        'lockstep_realtime_factor': round(duration / lockstep['sim_node']['wall_s'], 3),
        'latency_us': latency, 'echo_us': echo,
        'latency_to_echo': round(latency['p50'] / echo['p50'], 3),
        'deadline_misses': real_time['sim_node']['deadline_misses'],
        'recorder_cpu_share': round(recorder['cpu_s'] / wall, 4),
        'recorder_messages_per_s': round(recorder['messages'] / wall, 1),
        'recorder_lost': recorder['lost']}


def _run(folder: Path, duration: float, *, lockstep: bool) -> dict[str, Any]:
    """Run the scenario `quick` and return what each node counted."""
    setup = resolve('quick', plant='rigid', seed=0, duration=duration)
    config = folder / 'config'
    result = run_graph(GraphSpec(
        out=folder, ticks=setup.ticks, rate=setup.controller.rate, lockstep=lockstep,
        reference_file=config / 'reference.yaml', parameter_files=setup.write(config)))
    return dict(result.timing)


class Echo(Node):
    """Answers joint states, once the wrench of the same stamp is there, with a command."""

    def __init__(self) -> None:
        super().__init__('echo')
        self._stamps: dict[str, int] = {}
        self._out = create_publisher(self, topics.EFFORT_COMMAND)
        for topic in (topics.WRENCH, topics.JOINT_STATES):
            create_subscription(self, topic, self._taker(topic.name))

    def _taker(self, name: str) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            self._stamps[name] = messages.stamp_to_ns(message.header.stamp)
            if len(self._stamps) == 2 and len(set(self._stamps.values())) == 1:
                self._out.publish(JointState(
                    header=message.header, name=NAMES, effort=np.zeros(len(NAMES))))
        return take


class Caller(Node):
    """Sends both messages and waits for the answer."""

    def __init__(self) -> None:
        super().__init__('caller')
        self._outputs = {topic: create_publisher(self, topic)
                         for topic in (topics.WRENCH, topics.JOINT_STATES)}
        create_subscription(self, topics.EFFORT_COMMAND, self._on_answer)
        self._answered = -1
        self._executor = make_executor()
        self._executor.add_node(self)

    def _on_answer(self, message: Any) -> None:
        self._answered = messages.stamp_to_ns(message.header.stamp)
        self._arrived = time.monotonic_ns()

    def call(self, stamp: int, timeout: float) -> int:
        """Return the time from the first message to the answer [ns], -1 without one."""
        numbers = np.zeros(len(NAMES))
        wrench = messages.wrench_message(stamp, numbers, 'ft_face')
        joints = messages.joint_state_message(
            stamp, NAMES, position=numbers, velocity=numbers, effort=numbers)
        start = time.monotonic_ns()
        self._outputs[topics.WRENCH].publish(wrench)
        self._outputs[topics.JOINT_STATES].publish(joints)
        while self._answered != stamp and time.monotonic_ns() - start < timeout * 1e9:
            self._executor.spin_once(timeout_sec=0.1)
        return self._arrived - start if self._answered == stamp else -1


def echo_latency(calls: int, period: float) -> Vector:
    """Return round trips to another process [us], one every `period` [s] as in the graph."""
    other = subprocess.Popen(
        [sys.executable, '-m', 'multicontact_control.experiment.bench.graph'],
        stdout=subprocess.DEVNULL)
    start_ros([])
    caller = Caller()
    try:
        give_up, stamp = time.monotonic() + START_TIMEOUT, 1
        while caller.call(stamp, 0.2) < 0:
            stamp += 1
            if time.monotonic() > give_up or other.poll() is not None:
                raise RunError('the echo process does not answer')
        times = []
        for k in range(calls):
            due = time.monotonic() + period
            times.append(caller.call(stamp + 1 + k, ANSWER_TIMEOUT))
            time.sleep(max(0.0, due - time.monotonic()))
        answered = np.array([x for x in times if x >= 0], dtype=float)
        if not answered.size:
            raise RunError('the echo process does not answer')
        return 1e-3 * answered
    finally:
        caller.destroy_node()
        rclpy.try_shutdown()
        other.terminate()
        other.wait()


def main() -> None:
    """Echo until terminated."""
    start_ros([])
    node, executor = Echo(), make_executor()
    executor.add_node(node)
    while True:
        executor.spin_once(timeout_sec=1.0)


if __name__ == '__main__':
    main()
