"""The simulator's node in this process, with a controller that shares it."""

from collections.abc import Iterator
from contextlib import contextmanager
import json
import time

from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.composition import Composition
from multicontact_control.nodes.local_delivery import LocalDelivery
from multicontact_control.nodes.raw_messages import joint_state_reader, MessageTemplate
from multicontact_control.nodes.runtime import Spinner, StopFlag
from multicontact_control.paths import config_dir
import numpy as np
import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions
from sim_bridge.sim_node import SimNode

pytestmark = pytest.mark.ros

JOINTS = [f'joint{i}' for i in range(1, 7)]
LATE = (5, 6, 12)
TICKS = 20


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'ros'))


@contextmanager
def ros(*parameters) -> Iterator[None]:
    """Have ROS in this process, with parameters of the simulator."""
    arguments = [x for parameter in parameters for x in ('-p', parameter)]
    with reserve_domain() as domain_id:
        rclpy.init(args=[
            '--ros-args', '--params-file', str(config_dir() / 'plant_rigid.yaml'), *arguments,
            '--log-level', 'fatal'],
            domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
        try:
            yield
        finally:
            rclpy.try_shutdown()


def simulate(before, stop):
    """Run the simulator; each sample is answered by the torque it has, after `before(k)`."""
    local = LocalDelivery([topics.SIM, topics.CONTROLLER])
    reader = joint_state_reader(JOINTS)
    command = MessageTemplate(messages.joint_state_message(0, JOINTS, effort=np.zeros(6)))
    answered = []

    def answer(data):
        reading = reader.read(data)
        before(len(answered))
        answered.append(reading.stamp)
        local.send('/joint_effort_command', command.write(reading.stamp, reading.effort))

    local.subscribe('/joint_states', answer)
    nodes = Composition(SimNode(local), [], local)
    spinner = Spinner(nodes, stop)
    nodes.run(spinner)
    spinner.close()
    nodes.close()
    return answered


def test_answer_that_is_late_is_missed_even_if_the_simulator_waited_for_it(tmp_path):
    counts = tmp_path / 'counts.json'

    def be_late(k):
        if k in LATE:
            time.sleep(0.01)

    with ros(f'ticks:={TICKS}', f'timing_file:={counts}'):
        answered = simulate(be_late, StopFlag())
    told = json.loads(counts.read_text(encoding='utf-8'))
    assert len(answered) == told['ticks'] == TICKS
    assert told['deadline_misses'] >= len(LATE)
    histogram = told['latency_histogram']
    assert sum(histogram['counts']) == TICKS - 1
