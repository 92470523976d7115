"""The simulator's node in this process, with a controller in a thread."""

import json
import threading
import time

from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.link import GuestNode
from multicontact_control.nodes.runtime import Spinner, StopFlag
from multicontact_control.paths import config_dir
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from ros_graph import own_domain
from sim_bridge.sim_node import SimNode

pytestmark = pytest.mark.ros

LATE, TICKS = (5, 6, 12), 20


@pytest.fixture
def controller(tmp_path, monkeypatch):
    """Have ROS in this process, and answers to samples of the torque that acts; some late."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'ros'))
    with own_domain() as domain_id, GuestNode('controller_node', domain_id) as guest:
        stamps = []
        publisher = guest.node.create_publisher(
            topics.EFFORT_COMMAND.message, topics.EFFORT_COMMAND.name, qos.STREAM)

        def answer(sample):
            if len(stamps) in LATE:
                time.sleep(0.01)
            stamp = messages.stamp_to_ns(sample.header.stamp)
            stamps.append(stamp)
            publisher.publish(messages.joint_state_message(
                stamp, sample.name, effort=sample.effort))

        guest.node.create_subscription(
            topics.JOINT_STATES.message, topics.JOINT_STATES.name, answer, qos.INPUT)
        executor = SingleThreadedExecutor(context=guest.context)
        executor.add_node(guest.node)
        thread = threading.Thread(target=executor.spin)
        thread.start()
        yield domain_id, stamps
        executor.shutdown()
        thread.join()


@pytest.mark.parametrize('lockstep', [True, False])
def test_plant_waits_for_commands_in_lockstep_only(controller, tmp_path, lockstep):
    domain_id, stamps = controller
    counts = tmp_path / 'counts.json'
    parameters = [f'ticks:={TICKS}', f'timing_file:={counts}', f'lockstep:={lockstep}'.lower()]
    rclpy.init(args=['--ros-args', '--params-file', str(config_dir() / 'plant_rigid.yaml'),
                     *(x for name in parameters for x in ('-p', name)), '--log-level', 'fatal'],
               domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = SimNode()
        live, locked = node.set_parameters([
            Parameter('surfaces.table.stiffness', value=9000.0), Parameter('rate', value=400.0)])
        assert live.successful and not locked.successful, (live.reason, locked.reason)
        spinner = Spinner(node, StopFlag())
        node.run(spinner)
        spinner.close()
        node.close()
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    timing = json.loads(counts.read_text(encoding='utf-8'))
    assert timing['ticks'] == TICKS
    assert (timing['deadline_misses'] == 0) == lockstep
    if lockstep:
        assert stamps == sorted(set(stamps)) and len(stamps) == TICKS
        assert sum(timing['latency_histogram']['counts']) == TICKS - 1
