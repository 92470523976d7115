"""The recorder as a process over real middleware: asked to stop, and killed; and its bag."""

import contextlib
import errno
import json
import resource
import signal
import time

from arms import controller_config
from fake_arm import wrench_message
from multicontact_control.errors import ConfigError, MulticontactError, RunError
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph import create_publisher, READY
from multicontact_control.nodes.recorder_node import Bag, RecorderNode
from multicontact_control.runs.recording import read_bag
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from ros_graph import end_of, PATIENCE, recorded, wait_for
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

pytestmark = pytest.mark.ros


COUNT = 600
PERIOD = 2_000_000  # ns
START = 1_795_000_000_000_000_000  # ns
CONTROLLER = controller_config()


@pytest.fixture
def publishers(middleware):
    of_simulator = [topic for topic in topics.TOPICS if topic.publisher == topics.SIM]
    return {topic: create_publisher(middleware.node, topic) for topic in of_simulator}


@pytest.fixture
def record(middleware, tmp_path):
    """Return what starts a recorder of a simulator that this test is."""

    def start():
        process = middleware.start(
            'multicontact_control.nodes.recorder_node',
            f'folder:={tmp_path / "bag"}',
            f'timing_file:={tmp_path / "counts.json"}',
            'startup_peers:=[sim_node]',
        )

        def is_ready_or_has_ended():
            if process.poll() is not None:
                return True
            return middleware.node.count_publishers(READY + topics.RECORDER)

        wait_for(is_ready_or_has_ended, 'recorder connected')
        assert process.poll() is None, process.communicate()[1]
        return process

    return start


def publish(publishers, first, count):
    for k in range(first, first + count):
        stamp = PERIOD * (1 + k)
        joints = messages.joint_state_message(
            stamp,
            CONTROLLER.robot.joint_names,
            position=[0.001 * k] * 6,
            velocity=[0.0] * 6,
            effort=[k] * 6,
        )
        publishers[topics.JOINT_STATES].publish(joints)
        publishers[topics.TRUE_FORCES].publish(joints)
        publishers[topics.WRENCH].publish(wrench_message(stamp, 'ft_face', [k] * 6))
        time.sleep(0.0005)  # a few times faster than the graph, not without a limit


def counts_after(process, folder, number=signal.SIGINT):
    process.send_signal(number)
    process.send_signal(number)  # a Ctrl-C often comes twice
    _, errors = end_of(process)
    assert process.returncode == 0, errors
    return json.loads((folder / 'counts.json').read_text(encoding='utf-8'))


def test_recorder_keeps_every_message_and_what_was_latched_before_it_came(
    publishers, record, tmp_path
):
    publishers[topics.ROBOT_DESCRIPTION].publish(String(data='before it came'))
    process = record()
    publish(publishers, 0, COUNT)
    # Reliable is what the writer still repeats: a message that was dropped on a busy machine
    # comes again with the next heartbeat, which may be after the recorder's quiet time.
    for publisher in publishers.values():
        assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    counts = counts_after(process, tmp_path, signal.SIGTERM)
    bag = tmp_path / 'bag'
    for topic in (topics.JOINT_STATES, topics.TRUE_FORCES):
        efforts = [message.effort[0] for message in recorded(bag, topic.name)]
        assert efforts == [*range(COUNT)]
    for topic in (topics.JOINT_STATES, topics.TRUE_FORCES, topics.WRENCH):
        assert counts['counts'][f'/{topic.name}'] == COUNT
    assert counts['lost'] == 0
    (description,) = recorded(bag, 'robot_description')
    assert description.data == 'before it came'


def test_recorder_that_is_killed_leaves_a_bag_that_is_read(
    publishers, record, tmp_path
):
    process = record()
    folder = tmp_path / 'bag'

    def flushed():
        # As long as there is little to read it is an error.
        with contextlib.suppress(MulticontactError):
            return read_bag(folder, CONTROLLER).data.ticks >= COUNT

    publish(publishers, 0, COUNT)
    wait_for(flushed, 'what was recorded on disk')
    publish(publishers, COUNT, 1)
    process.kill()
    process.communicate()
    assert not (folder / 'metadata.yaml').exists()
    content = read_bag(folder, CONTROLLER)
    assert content.data.effort[:COUNT, 0].tolist() == [*range(COUNT)]
    assert 'cut off' in ' '.join(content.remarks)


def test_recorder_whose_disk_is_full_ends_in_a_line_and_leaves_a_bag_that_is_read(
    publishers, record, tmp_path
):
    process = record()
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (200_000, 200_000))
    for first in range(0, 1_000_000, 50):
        if process.poll() is not None:
            break
        publish(publishers, first, 50)
    assert process.returncode == errno.EFBIG
    _, errors = process.communicate()
    assert ': [Errno 27] File too large\n' in errors
    assert 'Traceback' not in errors
    assert 0 < read_bag(tmp_path / 'bag', CONTROLLER).data.ticks < first


@pytest.mark.parametrize(
    ('parameters', 'field'),
    [
        ([], 'folder'),
        (['folder:={folder}', 'effort_output_topic:=a b'], 'effort_output_topic'),
    ],
)
def test_recorder_refuses_what_it_cannot_record(domain_id, tmp_path, parameters, field):
    arguments = ['--ros-args']
    for parameter in parameters:
        arguments += ['-p', parameter.format(folder=tmp_path / 'bag')]
    rclpy.init(
        args=arguments,
        domain_id=domain_id,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    try:
        with pytest.raises(ConfigError, match=f'^{field}: expected'):
            RecorderNode()
    finally:
        rclpy.try_shutdown()
    assert not (tmp_path / 'bag').exists()


def test_bag_gives_back_bytes_times_and_qualities_of_service(tmp_path):
    folder = tmp_path / 'bag'
    sent = []
    for k in range(COUNT):
        message = wrench_message(START, 'ft_face', [k, 0, 0, 0, 0, -k])
        sent.append((START + k * PERIOD, serialize_message(message)))
    with contextlib.closing(Bag(folder)) as bag:
        wrench = bag.add_topic('/wrench', 'geometry_msgs/msg/WrenchStamped', qos.STREAM)
        bag.add_topic('/silent', 'std_msgs/msg/String', qos.LATCHED)
        for stamp, data in sent:
            bag.write(wrench, stamp, data)
        assert [*bag.counts.values()] == [COUNT, 0]
    with Reader(folder) as reader:
        stream, latched = (x.ext.offered_qos_profiles[0] for x in reader.connections)
        kept = [(stamp, bytes(data)) for _, stamp, data in reader.messages()]
    assert stream.durability == QosDurability.VOLATILE
    assert stream.reliability == QosReliability.RELIABLE
    assert latched.durability == QosDurability.TRANSIENT_LOCAL
    assert kept == sent
    with pytest.raises(RunError, match='expected a folder that does not exist yet'):
        Bag(folder)
