"""
A simulator that waits for its answers, and a controller that does not wait for its samples.

`docs/minimal_simulator.py` is what a user starts from. Between the two stands a relay that loses,
doubles and delays messages; the simulator is halted meanwhile, as by a busy machine.
"""

from collections import deque
import os
import signal
import subprocess
from threading import Thread
import time

from arms import seven_joint_urdf
from multicontact_control.config import merge, read_parameters
from multicontact_control.nodes import qos, topics
from multicontact_control.nodes.streams import HEADER, STAMP
from multicontact_control.runs.parameter_file import write_parameters
import numpy as np
import pytest
from rclpy.executors import SingleThreadedExecutor
from ros_graph import ROOT, start_python, wait_for
from sim_bridge.new_robot import new_robot

pytestmark = [pytest.mark.ros, pytest.mark.slow]

FAR = 'simulated/'  # before the names of topics on the simulator's side
SAMPLES = (topics.JOINT_STATES, topics.WRENCH)
ENOUGH = 25  # samples that are answered in a row after a disturbance
FATES = PASSED, LOST, DOUBLED, LATE = 'passed', 'lost', 'doubled', 'late'
SHARES = (0.94, 0.02, 0.02, 0.02)  # of the messages that have each of these fates
LATER = 8  # messages that overtake one that is late, at most
SHORTEST = 0.05  # s, of a stall
LONGEST = 10.0  # s, likewise, at night


class Relay:
    """Passes samples and commands on; while it is `rough`, not all of them, nor in order."""

    def __init__(self, node, random):
        self._random, self.rough, self.samples = random, False, 0
        self._newest = (0, 0)
        self._late = deque()
        for topic, source, sink in (
            *((topic, FAR + topic.name, topic.name) for topic in SAMPLES),
            (
                topics.EFFORT_COMMAND,
                topics.EFFORT_COMMAND.name,
                FAR + topics.EFFORT_COMMAND.name,
            ),
        ):
            publisher = node.create_publisher(topic.message, sink, qos.INPUT)
            node.create_subscription(
                topic.message,
                source,
                lambda data, topic=topic, send=publisher.publish: self._pass_on(
                    topic, data, send
                ),
                qos.INPUT,
                raw=True,
            )

    def _pass_on(self, topic, data, send):
        if topic is topics.JOINT_STATES:
            stamp = STAMP.unpack_from(data, HEADER)
            self.samples += stamp > self._newest
            self._newest = max(self._newest, stamp)
        fate = PASSED
        if self.rough:
            fate = self._random.choice(FATES, p=SHARES)
        if fate == LATE:
            self._late.append([self._random.integers(1, LATER), data, send])
        if fate in (PASSED, DOUBLED):
            send(data)
        if fate == DOUBLED:
            send(data)
        self._send_late()

    def _send_late(self):
        """Send what enough others have overtaken."""
        for entry in self._late:
            entry[0] -= 1
        while self._late and self._late[0][0] <= 0:
            _, data, send = self._late.popleft()
            send(data)


@pytest.fixture
def robot_files(tmp_path):
    """Write what `new-robot` does for the arm of seven joints."""
    arm = tmp_path / 'my_arm.yaml'
    controller = tmp_path / 'controller.yaml'
    new_robot(seven_joint_urdf(tmp_path), 'wrist', 'wrist', arm, controller)
    return arm, controller


@pytest.fixture
def start_simulator(domain_id, tmp_path):
    """Return what starts the minimal simulator behind the relay."""
    started = []

    def start(arm, controller):
        remappings = [
            part
            for topic in (*SAMPLES, topics.EFFORT_COMMAND)
            for part in ('-r', f'{topic.name}:={FAR}{topic.name}')
        ]
        started.append(
            start_python(
                ROOT / 'docs/minimal_simulator.py',
                arm,
                controller,
                '--ros-args',
                *remappings,
                env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)},
                stdout=(tmp_path / 'simulator.log').open('w'),
                stderr=subprocess.STDOUT,
            )
        )
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def stalls(random, count, longest):
    """Return lengths of stalls [s], as many short as long ones."""
    return np.exp(random.uniform(np.log(SHORTEST), np.log(longest), count))


@pytest.fixture
def relay(middleware):
    """Pass messages on in the background."""
    relay = Relay(middleware.node, np.random.default_rng(0))
    executor = SingleThreadedExecutor(context=middleware.node.context)
    executor.add_node(middleware.node)
    thread = Thread(target=executor.spin)
    thread.start()
    yield relay
    executor.shutdown()
    thread.join()


@pytest.mark.parametrize(
    ('settings', 'count', 'longest'),
    [
        ({}, 10, 0.3),
        pytest.param({}, 200, LONGEST, marks=pytest.mark.nightly),
        pytest.param({'patience': 0.0}, 50, LONGEST, marks=pytest.mark.nightly),
        pytest.param('simulated_arm.yaml', 50, LONGEST, marks=pytest.mark.nightly),
    ],
)
def test_simulator_that_waits_goes_on_after_stalls_and_lost_late_and_doubled_messages(
    middleware, relay, robot_files, start_simulator, settings, count, longest
):
    arm, controller = robot_files
    if isinstance(settings, str):
        settings = read_parameters(ROOT / 'config' / settings)
    write_parameters(controller, {'/**': merge(read_parameters(controller), settings)})
    middleware.start(
        'multicontact_control.nodes.controller_node',
        files=(controller,),
        flags=('--autostart',),
    )
    simulator = start_simulator(arm, controller)

    def go_on(what):
        until = relay.samples + ENOUGH
        wait_for(lambda: relay.samples >= until, f'{ENOUGH} samples {what}')

    go_on('at the start')
    for number, stall in enumerate(stalls(np.random.default_rng(1), count, longest)):
        relay.rough = True
        go_on(f'with messages lost, {number}')
        simulator.send_signal(signal.SIGSTOP)
        time.sleep(stall)
        simulator.send_signal(signal.SIGCONT)
        relay.rough = False
        go_on(f'after {stall:.3f} s, {number}')
