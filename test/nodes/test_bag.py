"""The bag that we write, as rosbags reads it."""

from contextlib import closing

from fake_arm import wrench_message
from multicontact_control.errors import RunError
from multicontact_control.nodes import qos
from multicontact_control.nodes.recorder_node import Bag
import pytest
from rclpy.serialization import serialize_message
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader

START, PERIOD, COUNT = 1_795_000_000_000_000_000, 2_000_000, 250


def test_bag_gives_back_bytes_times_and_qualities_of_service(tmp_path):
    folder = tmp_path / 'bag'
    sent = [(START + k * PERIOD, serialize_message(wrench_message(
        START, [k, 0, 0, 0, 0, -k], 'ft_face'))) for k in range(COUNT)]
    with closing(Bag(folder)) as bag:
        wrench = bag.add_topic('/wrench', 'geometry_msgs/msg/WrenchStamped', qos.STREAM)
        bag.add_topic('/silent', 'std_msgs/msg/String', qos.LATCHED)
        with pytest.raises(RunError, match='no_such_msgs'):
            bag.add_topic('/thing', 'no_such_msgs/msg/Thing', qos.STREAM)
        for time, data in sent:
            bag.write(wrench, time, data)
        assert [*bag.counts.values()] == [COUNT, 0]
    with Reader(folder) as reader:
        profiles = [x.ext.offered_qos_profiles[0] for x in reader.connections]
        assert [x.durability for x in profiles] == [
            QosDurability.VOLATILE, QosDurability.TRANSIENT_LOCAL]
        assert profiles[0].reliability == QosReliability.RELIABLE
        assert [(time, bytes(data)) for _, time, data in reader.messages()] == sent
    with pytest.raises(RunError, match='expected a folder that does not exist yet'):
        Bag(folder)
