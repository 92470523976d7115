"""The bag that we write, read by readers that are not ours."""

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from multicontact_control.errors import RunError
from multicontact_control.nodes import messages, qos
from multicontact_control.nodes.bag import Bag
from multicontact_control.nodes.topics import TOPICS
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader

START, PERIOD, COUNT = 1_795_000_000_000_000_000, 2_000_000, 250


def test_bag_gives_back_messages_times_and_qualities_of_service(tmp_path):
    folder = tmp_path / 'bag'
    with Bag(folder) as bag:
        bag.add_topic('/wrench', 'geometry_msgs/msg/WrenchStamped', qos.STREAM)
        bag.add_topic('/silent', 'std_msgs/msg/String', qos.LATCHED)
        for k in range(COUNT):
            wrench = messages.wrench_message(START, [k, 0, 0, 0, 0, -k], 'ft_face')
            bag.write('/wrench', serialize_message(wrench), START + k * PERIOD)
        assert bag.counts() == {'/wrench': COUNT, '/silent': 0}
    with Reader(folder) as reader:
        assert reader.start_time == START
        profiles = [x.ext.offered_qos_profiles[0] for x in reader.connections]
        assert [x.durability for x in profiles] == [
            QosDurability.VOLATILE, QosDurability.TRANSIENT_LOCAL]
        assert profiles[0].reliability == QosReliability.RELIABLE
    path, = folder.glob('*.mcap')
    with path.open('rb') as stream:
        decoded = list(make_reader(
            stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    assert [x.message.log_time for x in decoded] == [START + k * PERIOD for k in range(COUNT)]
    assert [x.decoded_message.wrench.torque.z for x in decoded] == [-k for k in range(COUNT)]
    with pytest.raises(RunError, match='expected a folder that does not exist yet'):
        Bag(folder)


def test_bag_carries_the_definition_of_every_type_of_the_graph(tmp_path):
    with Bag(tmp_path / 'bag') as bag:
        for k, topic in enumerate(TOPICS):
            bag.add_topic(f'/{k}', topic.type_name, topic.profile)
            bag.write(f'/{k}', serialize_message(filled(topic.message())), START + k)
    with AnyReader([tmp_path / 'bag']) as reader:
        theirs = [(reader.deserialize(data, x.msgtype), x.msgtype)
                  for x, _, data in reader.messages()]
        found = [bytes(reader.typestore.serialize_cdr(*message)) for message in theirs]
    assert [deserialize_message(data, topic.message) for data, topic in zip(found, TOPICS)] == [
        filled(topic.message()) for topic in TOPICS]


def filled(message):
    """Return a message with something in its fields."""
    some = {'sequence<double>': [1.5, -2.5], 'sequence<string>': ['one', 'other'],
            'string': 'text', 'double': 0.25}
    for field, kind in message.get_fields_and_field_types().items():
        if kind in some:
            setattr(message, field, some[kind])
        elif hasattr(getattr(message, field), 'get_fields_and_field_types'):
            filled(getattr(message, field))
    return message


def test_bag_refuses_a_type_without_a_definition(tmp_path):
    with Bag(tmp_path / 'bag') as bag, pytest.raises(RunError, match='no_such_msgs'):
        bag.add_topic('/thing', 'no_such_msgs/msg/Thing', qos.STREAM)


def test_bag_without_a_message_can_be_read(tmp_path):
    with Bag(tmp_path / 'bag') as bag:
        bag.add_topic('/forces', 'sensor_msgs/msg/JointState', qos.STREAM)
    with Reader(tmp_path / 'bag') as reader:
        assert reader.message_count == 0
