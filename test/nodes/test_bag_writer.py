"""The bag that we write, read by readers that are not ours."""

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from multicontact_control.dynamics.link_transforms import LinkTransform
from multicontact_control.errors import RunError
from multicontact_control.nodes import messages, qos
from multicontact_control.nodes.bag_writer import BagWriter
from multicontact_control.nodes.message_definitions import message_hash, message_text, TF_TYPE
from multicontact_control.nodes.tf_recording import tf_bytes
from multicontact_control.nodes.topics import TOPICS
import pytest
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
import yaml

START = 1_795_000_000_000_000_000
PERIOD = 2_000_000
COUNT = 250


@pytest.fixture
def bag(tmp_path):
    """Write one stream of forces and one of wrenches, and a topic without a message."""
    folder = tmp_path / 'bag'
    with BagWriter(folder, chunk_size=4096) as writer:
        writer.add_topic('/forces', 'sensor_msgs/msg/JointState', qos.STREAM)
        writer.add_topic('/wrench', 'geometry_msgs/msg/WrenchStamped', qos.STREAM)
        writer.add_topic(
            '/silent', 'trajectory_msgs/msg/MultiDOFJointTrajectoryPoint', qos.LATCHED)
        for k in range(COUNT):
            time = START + k * PERIOD
            # No empty list: serialize_message() then returns more bytes than go over the wire.
            force = messages.joint_state_message(
                time, ['table'], position=[k], velocity=[k], effort=[0.1 * k])
            wrench = messages.wrench_message(time, [k, 0, 0, 0, 0, -k], 'ft_face')
            writer.write('/forces', serialize_message(force), time + 500, time, k + 1)
            writer.write('/wrench', serialize_message(wrench), time + 400, time, k + 1)
    return folder


def test_bag_writer_counts_and_times_are_those_of_the_messages(bag):
    text = (bag / 'metadata.yaml').read_text(encoding='utf-8')
    information = yaml.safe_load(text)['rosbag2_bagfile_information']
    assert information['version'] == 9
    assert information['storage_identifier'] == 'mcap'
    assert information['message_count'] == 2 * COUNT
    assert information['starting_time']['nanoseconds_since_epoch'] == START + 400
    assert information['duration']['nanoseconds'] == (COUNT - 1) * PERIOD + 100


def test_bag_writer_writes_what_rosbags_reads(bag):
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag) as reader:
        counts = {x.topic: x.msgcount for x in reader.connections}
        assert counts == {'/forces': COUNT, '/wrench': COUNT, '/silent': 0}
        profile = reader.connections[0].ext.offered_qos_profiles[0]
        assert profile.reliability == QosReliability.RELIABLE
        assert profile.durability == QosDurability.VOLATILE
        forces = [
            (time, store.deserialize_cdr(data, connection.msgtype))
            for connection, time, data in reader.messages() if connection.topic == '/forces']
    assert [time for time, _ in forces] == [START + k * PERIOD + 500 for k in range(COUNT)]
    assert [x.effort[0] for _, x in forces] == [0.1 * k for k in range(COUNT)]
    assert forces[0][1].name == ['table']


def test_bag_writer_schemas_are_enough_to_decode(bag):
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            assert message.header.stamp.sec == START // 1_000_000_000


def test_bag_writer_file_alone_is_read_by_mcap(bag):
    with (bag / 'bag_0.mcap').open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == 'ros2'
        decoded = list(reader.iter_decoded_messages(topics=['/wrench']))
    assert [x.message.publish_time for x in decoded] == [
        START + k * PERIOD for k in range(COUNT)]
    assert [x.decoded_message.wrench.torque.z for x in decoded] == [-k for k in range(COUNT)]
    assert [x.message.sequence for x in decoded] == list(range(1, COUNT + 1))


def test_bag_writer_carries_every_type_of_the_graph_to_others(tmp_path):
    """Each message comes back as it was, also those that no run has."""
    with BagWriter(tmp_path / 'bag') as writer:
        for k, topic in enumerate(TOPICS):
            writer.add_topic(f'/{k}', topic.type_name, topic.profile)
            writer.write(f'/{k}', serialize_message(full(topic.message())), START + k, START + k)
        writer.add_topic('/tf', TF_TYPE, qos.STREAM)
        transform = LinkTransform('world', 'base', (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
        writer.write('/tf', tf_bytes(START, [transform]), START + len(TOPICS), START)
    with AnyReader([tmp_path / 'bag']) as reader:
        theirs = [reader.deserialize(data, x.msgtype) for x, _, data in reader.messages()]
    with (tmp_path / 'bag' / 'bag_0.mcap').open('rb') as stream:
        decoded = [x.decoded_message for x in make_reader(
            stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()]
    assert len(theirs) == len(decoded) == len(TOPICS) + 1
    for topic, *read in zip(TOPICS, theirs, decoded):
        for message in read:
            assert_same(message, full(topic.message()), topic.type_name)
    for message in (theirs[-1], decoded[-1]):
        assert message.transforms[0].transform.translation.z == 3.0


def full(message):
    """Return a message with something in its lists, which may not be empty when serialised."""
    for field, kind in message.get_fields_and_field_types().items():
        value = getattr(message, field)
        if hasattr(value, 'get_fields_and_field_types'):
            full(value)
        elif kind == 'sequence<double>':
            setattr(message, field, [1.5, -2.5])
        elif kind == 'sequence<string>':
            setattr(message, field, ['one', 'other'])
        elif kind == 'string':
            setattr(message, field, field)
        elif kind == 'double':
            setattr(message, field, 0.25)
    return message


def assert_same(found, sent, where):
    for field in sent.get_fields_and_field_types():
        value, other = getattr(found, field), getattr(sent, field)
        if hasattr(other, 'get_fields_and_field_types'):
            assert_same(value, other, f'{where}.{field}')
        elif isinstance(other, bytes):  # one, that others take for a number
            assert value in (other, other[0]), f'{where}.{field}'
        elif isinstance(other, (str, int, float)):
            assert value == other, f'{where}.{field}'
        else:
            assert list(value) == list(other), f'{where}.{field}'


def test_bag_writer_with_no_message_is_a_bag(tmp_path):
    writer = BagWriter(tmp_path / 'empty')
    writer.add_topic('/forces', 'sensor_msgs/msg/JointState', qos.STREAM)
    writer.close()
    writer.close()
    with Reader(tmp_path / 'empty') as reader:
        assert reader.message_count == 0


def test_bag_writer_never_overwrites(bag):
    with pytest.raises(RunError, match='bag_0.mcap: already recorded'):
        BagWriter(bag)


def test_bag_writer_names_a_type_that_is_not_installed(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer, pytest.raises(
            RunError, match='no_such_msgs/msg/Thing: package no_such_msgs is not installed'):
        writer.add_topic('/thing', 'no_such_msgs/msg/Thing', qos.STREAM)


def test_message_text_carries_every_inner_type_once():
    text = message_text('trajectory_msgs/msg/MultiDOFJointTrajectoryPoint')
    inner = [line for line in text.splitlines() if line.startswith('MSG: ')]
    assert sorted(inner) == sorted(f'MSG: {x}' for x in (
        'geometry_msgs/Transform', 'geometry_msgs/Twist', 'geometry_msgs/Vector3',
        'geometry_msgs/Quaternion', 'builtin_interfaces/Duration'))


@pytest.mark.parametrize('topic', TOPICS, ids=lambda topic: topic.name)
def test_message_hash_is_that_of_the_running_types(topic, middleware):
    """The middleware announces the hash that its compiled types have."""
    publisher = middleware.node.create_publisher(topic.message, topic.name, topic.profile)
    # A node of an earlier test that was killed seems to publish for a while.
    info, = (info for info in middleware.node.get_publishers_info_by_topic(publisher.topic_name)
             if info.node_name == middleware.node.get_name())
    assert str(info.topic_type_hash) == message_hash(topic.type_name)
    assert info.topic_type == topic.type_name
