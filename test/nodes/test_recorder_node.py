"""The recorder as a process over real middleware: asked to stop, and killed."""

from __future__ import annotations

import itertools
import json
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from multicontact_control.nodes import messages, qos, topics
from multicontact_control.nodes.graph_node import create_subscription, ignore, ready_topic
import pytest
from rclpy.duration import Duration
from rclpy.serialization import deserialize_message
from ros_graph import end_of, PATIENCE, wait_for
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState

pytestmark = pytest.mark.ros

RECORDER = 'multicontact_control.nodes.recorder_node'
RECORDED = (topics.JOINT_STATES, topics.TRUE_FORCES, topics.WRENCH)
COUNT = 1500
STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture
def publishers(middleware):
    return {
        topic: middleware.node.create_publisher(topic.message, topic.name, topic.profile)
        for topic in RECORDED}


def start_recorder(middleware, folder, publishers, *parameters):
    names = json.dumps([topic.name for topic in publishers])
    process = middleware.start(
        RECORDER, f'folder:={folder}', f'topics:={names}', 'startup_peers:=[sim_node]',
        *parameters)
    ready = ready_topic(topics.RECORDER)
    wait_for(lambda: process.poll() is not None or middleware.node.count_publishers(ready),
             'recorder connected')
    assert process.poll() is None, process.communicate()[1]
    return process


def publish(publishers, first, count):
    for k in range(first, first + count):
        stamp = 1 + k * 2_000_000
        for topic, publisher in publishers.items():
            if topic is topics.WRENCH:
                message = messages.wrench_message(stamp, [k] * 6, 'ft_face')
            else:
                message = messages.joint_state_message(stamp, ['a'], effort=[k])
            publisher.publish(message)
        time.sleep(0.0005)  # a few times faster than the graph, not without a limit


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_recorder_keeps_every_message_and_closes_the_bag(
        middleware, publishers, tmp_path, number):
    counts_file = tmp_path / 'counts.json'
    process = start_recorder(
        middleware, tmp_path / 'bag', publishers, f'timing_file:={counts_file}')
    publish(publishers, 0, COUNT)
    # Reliable is what the writer still repeats: a message that was dropped on a busy machine
    # comes again with the next heartbeat, which may be after the recorder's quiet time.
    for publisher in publishers.values():
        assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    process.send_signal(number)
    process.send_signal(number)  # a Ctrl-C often comes twice
    _, errors = end_of(process)
    assert process.returncode == 0, errors
    with Reader(tmp_path / 'bag') as reader:
        assert {x.topic: x.msgcount for x in reader.connections} == {
            f'/{topic.name}': COUNT for topic in RECORDED}
        efforts = [
            STORE.deserialize_cdr(data, connection.msgtype).effort[0]
            for connection, _, data in reader.messages() if connection.topic == '/joint_states']
    assert efforts == [float(k) for k in range(COUNT)]
    counts = json.loads(counts_file.read_text(encoding='utf-8'))
    assert (counts['messages'], counts['lost'], counts['before_start']) == (
        COUNT * len(RECORDED), 0, 0)


def test_numbers_of_two_publishers_are_not_taken_for_losses(middleware, tmp_path):
    """A gripper publishes its joints on the arm's topic; each counts by itself."""
    counts_file = tmp_path / 'counts.json'
    arm, gripper = (middleware.node.create_publisher(JointState, 'joint_states', qos.STREAM)
                    for _ in range(2))
    process = start_recorder(middleware, tmp_path / 'bag', {topics.JOINT_STATES: arm},
                             f'timing_file:={counts_file}')
    for k in range(200):
        arm.publish(messages.joint_state_message(2 * k, ['a'], effort=[k]))
        if k > 100:
            gripper.publish(messages.joint_state_message(2 * k + 1, ['finger'], effort=[k]))
        time.sleep(0.002)
    for publisher in (arm, gripper):
        assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    process.send_signal(signal.SIGINT)
    _, errors = end_of(process)
    assert process.returncode == 0, errors
    counts = json.loads(counts_file.read_text(encoding='utf-8'))
    assert (counts['messages'], counts['lost']) == (299, 0)


def test_only_what_has_come_and_stays_away_is_told(middleware, publishers, tmp_path):
    """No graph has all that can be recorded: every default run warned of what it has not."""
    told = []
    listener = create_subscription(
        middleware.node, topics.DIAGNOSTICS, ignore, topics.DIAGNOSTICS.profile)
    process = start_recorder(middleware, tmp_path / 'bag', publishers)
    some, sent = {topics.JOINT_STATES: publishers[topics.JOINT_STATES]}, itertools.count()

    def inputs():
        message = middleware.take(listener, DiagnosticArray)
        if message is not None:
            told.extend(part for part in message.status if part.name.endswith(': inputs'))
        return told[-1] if told else None

    def comes():
        publish(some, next(sent), 1)
        report = inputs()
        return report if report and report.values else None

    report = wait_for(comes, 'a report while samples come', inputs)
    assert (report.level, report.message) == (DiagnosticStatus.OK, 'ok')
    wait_for(lambda: (report := inputs()) and report.level == DiagnosticStatus.WARN,
             'a warning once they do not', inputs)
    assert told[-1].message.startswith('no /joint_states for')
    assert 'ground_truth' not in told[-1].message
    process.send_signal(signal.SIGINT)
    end_of(process)


def test_what_is_published_best_effort_is_recorded_so(middleware, tmp_path):
    publisher = middleware.node.create_publisher(JointState, 'joint_states', qos.SENSOR)
    process = middleware.start(
        RECORDER, f'folder:={tmp_path / "bag"}', 'topics:=["joint_states"]')
    wait_for(publisher.get_subscription_count, 'a reader that asks for no more')
    for k in range(50):
        publisher.publish(messages.joint_state_message(k, ['a'], effort=[k]))
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    _, errors = end_of(process)
    assert 'joint_states: recorded best effort, as published' in errors
    with Reader(tmp_path / 'bag') as reader:
        assert sum(x.msgcount for x in reader.connections) > 25


def test_what_is_published_best_effort_beside_others_is_recorded(middleware, tmp_path):
    arm = middleware.node.create_publisher(JointState, 'joint_states', qos.STREAM)
    process = middleware.start(
        RECORDER, f'folder:={tmp_path / "bag"}', 'topics:=["joint_states"]')
    wait_for(arm.get_subscription_count, 'a reader')
    gripper = middleware.node.create_publisher(JointState, 'joint_states', qos.SENSOR)
    sent = itertools.count(1)

    def connected():
        arm.publish(messages.joint_state_message(2 * next(sent), ['a'], effort=[0.0]))
        return gripper.get_subscription_count()

    wait_for(connected, 'a reader that asks for no more')
    for _ in range(50):
        connected()
        gripper.publish(messages.joint_state_message(2 * next(sent), ['finger'], effort=[0.0]))
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    _, errors = end_of(process)
    assert 'joint_states: recorded best effort, as published' in errors
    with Reader(tmp_path / 'bag') as reader:
        names = [STORE.deserialize_cdr(data, x.msgtype).name[0]
                 for x, _, data in reader.messages()]
    assert names.count('finger') > 25
    assert names.count('a') > 25


def test_recorder_that_is_killed_leaves_all_whole_chunks(middleware, publishers, tmp_path):
    folder = tmp_path / 'bag'
    process = start_recorder(middleware, folder, publishers, 'chunk_size:=4096')
    path = folder / 'bag_0.mcap'
    publish(publishers, 0, COUNT)
    wait_for(lambda: len(recover(path, '/joint_states')) > COUNT // 4, 'chunks on disk')
    process.kill()
    process.communicate()
    recovered = recover(path, '/joint_states')
    assert len(recovered) > COUNT // 4
    assert recovered == [float(k) for k in range(len(recovered))]
    assert not (folder / 'metadata.yaml').exists()


def recover(path, topic):
    """Return the efforts of a topic up to the cut."""
    efforts = []
    with path.open('rb') as stream:
        try:
            for _, channel, message in NonSeekingReader(stream).iter_messages(
                    log_time_order=False):
                if channel.topic == topic:
                    efforts.append(deserialize_message(message.data, JointState).effort[0])
        except (McapError, EOFError):
            pass
    return efforts


def test_recorder_refuses_an_unknown_topic(middleware, tmp_path):
    process = middleware.start(RECORDER, f'folder:={tmp_path}/bag', 'topics:=[joint_stats]')
    _, errors = end_of(process)
    assert process.returncode == 2
    assert 'topics: expected names among joint_states' in errors
    assert errors.rstrip().endswith("found 'joint_stats'")
    assert len(errors.splitlines()) == 1


@pytest.mark.parametrize(('text', 'expected'), [
    ('/commands', 'NAME TYPE of topics beside those of the graph'),
    ('joint_states sensor_msgs/msg/JointState', 'NAME TYPE of topics beside those of the graph'),
    ('/joint_states sensor_msgs/msg/JointState', 'NAME TYPE of topics beside those of the graph'),
    ('1st sensor_msgs/msg/JointState', 'a name of a topic'),
    ('/a//b sensor_msgs/msg/JointState', 'a name of a topic'),
    ('/commands nowhere_msgs/msg/Nothing', 'types that are installed')])
def test_recorder_refuses_extra_topics_that_cannot_be(middleware, tmp_path, text, expected):
    process = middleware.start(
        RECORDER, f'folder:={tmp_path}/bag', f'extra_topics:=["{text}"]')
    _, errors = end_of(process)
    assert process.returncode == 2
    assert f'extra_topics: expected {expected}, found ' in errors
    assert len(errors.splitlines()) == 1


def test_recorder_that_cannot_begin_leaves_no_bag_in_the_way_of_another(
        middleware, publishers, tmp_path):
    twice = json.dumps(['/a std_msgs/msg/String', 'a std_msgs/msg/String'])
    process = middleware.start(
        RECORDER, f'folder:={tmp_path / "bag"}', f'extra_topics:={twice}')
    _, errors = end_of(process)
    assert process.returncode == 2
    assert 'topics: expected each once in a bag, found /a twice' in errors
    assert len(errors.splitlines()) == 1
    file = tmp_path / 'bag' / 'bag_0.mcap'
    assert not file.exists()
    process = start_recorder(middleware, tmp_path / 'bag', publishers)
    wait_for(lambda: process.poll() is not None or file.exists(), 'a bag')
    process.send_signal(signal.SIGINT)
    _, errors = end_of(process)
    assert process.returncode == 0, errors
    assert (tmp_path / 'bag' / 'metadata.yaml').exists()


def test_recorder_needs_a_folder(middleware):
    process = middleware.start(RECORDER)
    _, errors = end_of(process)
    assert process.returncode == 2
    assert 'folder: expected a value, found nothing' in errors


def test_recorder_refuses_a_parameter_file_that_is_not_one(middleware, tmp_path):
    path = tmp_path / 'mixed.yaml'
    path.write_text('/**:\n  ros__parameters:\n    a: [0, 1.5]\n', encoding='utf-8')
    process = middleware.start(RECORDER, files=(path,))
    _, errors = end_of(process)
    assert process.returncode == 2
    assert 'mixed.yaml' in errors.splitlines()[-1]
    assert 'Traceback' not in errors
