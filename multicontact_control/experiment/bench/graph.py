"""
The ROS 2 graph: lockstep factor, latency against a bare echo, what the recorder takes.

The floor of the latency is two bare rclpy processes that echo the same two messages, as message
objects or as bytes; this module is the other one.
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
from multicontact_control.control_loop import ControlLoop
from multicontact_control.errors import RunError
from multicontact_control.experiment.bench.timing import rounded_percentiles, stopwatch
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.run import GraphSpec, run_graph
from multicontact_control.experiment.scenario import resolve, Setup
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph_node import create_publisher
from multicontact_control.nodes.loop_statistics import NANOSECONDS
from multicontact_control.nodes.raw_messages import HEADER, MessageTemplate, STAMP
from multicontact_control.nodes.runtime import make_executor, start_ros
import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from sim_bridge.plant import Plant

NAMES = tuple(f'joint{i + 1}' for i in range(6))
START_TIMEOUT, ANSWER_TIMEOUT = 20.0, 1.0
PERIOD = 1.0 / 500.0


def bench_graph(duration: float) -> dict[str, Any]:
    """Run the graph in lockstep and in real time [s], and the echo with the same period."""
    with TemporaryDirectory() as name:
        lockstep = _run(Path(name) / 'lockstep', duration, lockstep=True, composed='all')
        real_time = _run(Path(name) / 'real_time', duration, lockstep=False)
        composed = _run(Path(name) / 'composed', duration, lockstep=False, composed='all')
    with reserve_domain(None) as domain_id:
        os.environ['ROS_DOMAIN_ID'] = str(domain_id)
        calls = int(500 * duration)
        echo, raw_echo = (rounded_percentiles(echo_latency(calls, PERIOD, raw=raw))
                          for raw in (False, True))
        floor = echo_latency(calls, 0.0, raw=False)
    latency = real_time['sim_node']['latency_us']
    recorder = real_time['recorder_node']
    wall = real_time['sim_node']['wall_s']
    lockstep_rate = lockstep['sim_node']['ticks'] / lockstep['sim_node']['wall_s']
    at_once, paced = (in_process_times(duration, period) for period in (0.0, PERIOD))
    in_node = {'tick': real_time['controller_node']['stages_us']['step']['p50'],
               'plant': real_time['sim_node']['plant_us']['p50']}
    return {
        'lockstep_realtime_factor': round(duration / lockstep['sim_node']['wall_s'], 3),
        'lockstep_to_floor': round(lockstep_rate * float(np.mean(floor)) * 1e-6, 3),
        'latency_us': latency, 'echo_us': echo, 'raw_echo_us': raw_echo,
        'latency_to_echo': round(latency['p50'] / echo['p50'], 3),
        'latency_p99_to_period': round(latency['p99'] * 1e-6 / PERIOD, 3),
        'node_us': real_time['controller_node']['stages_us'],
        'in_process_us': at_once, 'paced_in_process_us': paced,
        'node_to_in_process': {x: round(in_node[x] / at_once[x], 3) for x in in_node},
        'node_to_paced_in_process': {x: round(in_node[x] / paced[x], 3) for x in in_node},
        'deadline_misses': real_time['sim_node']['deadline_misses'],
        'composed_latency_us': composed['sim_node']['latency_us'],
        'composed_deadline_misses': composed['sim_node']['deadline_misses'],
        'recorder_cpu_share': round(recorder['cpu_s'] / wall, 4),
        'recorder_messages_per_s': round(recorder['messages'] / wall, 1),
        'recorder_lost': recorder['lost']}


def in_process_times(duration: float, period: float) -> dict[str, float]:
    """
    Return medians of a tick and of a step of the plant in the same scenario in process [us].

    With the `period` [s] of the graph between them, caches are as cold as there; with 0, not.
    """
    setup = _setup(duration)
    places = ((ControlLoop, 'answer', 'tick'), (Plant, 'step', 'plant'))
    loop = ClosedLoop(setup)
    with stopwatch(places) as spent:
        for _ in range(setup.ticks):
            due = time.monotonic() + period
            loop.advance()
            time.sleep(max(0.0, due - time.monotonic()))
    loop.close()
    return {stage: round(float(np.median(taken)), 1) for (stage, _), taken in spent.items()}


def _setup(duration: float) -> Setup:
    return resolve('quick', plant='rigid', seed=0, duration=duration)


def _run(
    folder: Path, duration: float, *, lockstep: bool, composed: str = 'none',
) -> dict[str, Any]:
    """Run the scenario `quick` and return what each node counted."""
    setup = _setup(duration)
    config = folder / 'config'
    result = run_graph(GraphSpec(
        out=folder, ticks=setup.ticks, rate=setup.controller.rate, lockstep=lockstep,
        reference_file=config / 'reference.yaml', parameter_files=setup.write(config),
        composed=composed))
    return dict(result.timing)


class Echo(Node):
    """Answers joint states, once the wrench of the same stamp is there, with a command."""

    def __init__(self, *, raw: bool) -> None:
        super().__init__('echo')
        self._stamps: dict[str, int] = {}
        self._out = create_publisher(self, topics.EFFORT_COMMAND)
        self._template = MessageTemplate(messages.joint_state_message(
            0, NAMES, effort=np.zeros(len(NAMES))))
        for topic in (topics.WRENCH, topics.JOINT_STATES):
            self.create_subscription(
                topic.message, topic.name, self._taker(topic.name, raw=raw), qos.INPUT, raw=raw)

    def _taker(self, name: str, *, raw: bool) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            self._stamps[name] = messages.stamp_to_ns(message.header.stamp)
            if self._complete():
                self._out.publish(JointState(
                    header=message.header, name=NAMES, effort=np.zeros(len(NAMES))))

        def take_raw(data: bytes) -> None:
            sec, nanosec = STAMP.unpack_from(data, HEADER)
            self._stamps[name] = stamp = sec * NANOSECONDS + nanosec
            if self._complete():
                self._out.publish(self._template.write(stamp, np.zeros(len(NAMES))))
        return take_raw if raw else take

    def _complete(self) -> bool:
        return len(self._stamps) == 2 and len(set(self._stamps.values())) == 1


class Caller(Node):
    """Sends both messages and waits for the answer."""

    def __init__(self) -> None:
        super().__init__('caller')
        self._outputs = {topic: create_publisher(self, topic)
                         for topic in (topics.WRENCH, topics.JOINT_STATES)}
        self.create_subscription(
            topics.EFFORT_COMMAND.message, topics.EFFORT_COMMAND.name, self._on_answer, qos.INPUT)
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


def echo_latency(calls: int, period: float, *, raw: bool) -> Vector:
    """
    Return round trips to another process [us], one every `period` [s] as in the graph.

    With a `period` of 0 one follows the other. The other process reads and writes bytes if `raw`.
    """
    other = subprocess.Popen(
        [sys.executable, '-m', 'multicontact_control.experiment.bench.graph', str(int(raw))],
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
    node, executor = Echo(raw=sys.argv[1:] == ['1']), make_executor()
    executor.add_node(node)
    while True:
        executor.spin_once(timeout_sec=1.0)


if __name__ == '__main__':
    main()
