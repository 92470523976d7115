"""/tf in a bag, read by a reader that is not ours."""

from multicontact_control.dynamics.link_transforms import LinkTransform
from multicontact_control.nodes import messages
from multicontact_control.nodes.bag_writer import BagWriter
from multicontact_control.nodes.message_definitions import message_hash, message_text, TF_TYPE
from multicontact_control.nodes.tf_recording import tf_bytes, TfRecording
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from rclpy.logging import get_logger
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from std_msgs.msg import String

STORE = get_typestore(Stores.ROS2_JAZZY)
STAMP = 1_795_000_000_123_456_789
JOINTS = [f'joint{k}' for k in range(1, 7)]


def test_tf_type_is_the_one_that_others_know():
    assert message_hash(TF_TYPE) == STORE.hash_rihs01(TF_TYPE)
    inner = {line for line in message_text(TF_TYPE).splitlines() if line.startswith('MSG: ')}
    assert {'MSG: geometry_msgs/TransformStamped', 'MSG: std_msgs/Header'} <= inner


@pytest.mark.parametrize('names', [('world', 'a'), ('', 'long_name'), ('abc', 'abcd')])
def test_tf_bytes_are_those_that_rosbags_reads_and_writes(names):
    """Names of every length, so that every alignment occurs."""
    transforms = [
        LinkTransform(names[0], names[1] + 'x' * k, (1.0 + k, 2.0, 3.0), (0.1, 0.2, 0.3, 0.9))
        for k in range(9)]
    data = tf_bytes(STAMP, transforms)
    message = STORE.deserialize_cdr(data, TF_TYPE)
    assert bytes(STORE.serialize_cdr(message, TF_TYPE)) == data
    for found, sent in zip(message.transforms, transforms):
        assert (found.header.frame_id, found.child_frame_id) == (sent.parent, sent.child)
        assert found.header.stamp.sec * 10**9 + found.header.stamp.nanosec == STAMP
        assert found.transform.translation.x == sent.translation[0]
        assert found.transform.rotation.w == 0.9


def test_tf_recording_is_decimated_in_the_time_of_the_samples(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        tf = TfRecording(writer, 50.0, get_logger('test'))
        joints = [serialize_message(messages.joint_state_message(
            STAMP + 2_000_000 * k, JOINTS, position=[0.1] * 6, velocity=[0.0] * 6,
            effort=[0.0] * 6)) for k in range(100)]
        tf.on_joint_states(joints[0], 1, 1)  # no description yet
        tf.on_description(serialize_message(String(data='<no urdf')), 2, 2)
        text = (config_dir() / 'puma560.urdf').read_text(encoding='utf-8')
        tf.on_description(serialize_message(String(data=text)), 2, 2)
        for k, data in enumerate(joints):
            tf.on_joint_states(data, 10 + k, 10 + k)
    with Reader(tmp_path / 'bag') as reader:
        found = [STORE.deserialize_cdr(data, x.msgtype) for x, _, data in reader.messages()]
    assert len(found) == 10
    children = {x.child_frame_id for x in found[0].transforms}
    assert {'base_link', 'link6', 'ft_face', 'tip_table', 'tip_board'} <= children


def test_tf_recording_leaves_out_what_is_not_finite(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        tf = TfRecording(writer, 50.0, get_logger('test'))
        text = (config_dir() / 'puma560.urdf').read_text(encoding='utf-8')
        tf.on_description(serialize_message(String(data=text)), 1, 1)
        for k, position in enumerate((float('inf'), float('nan'), 0.1)):
            message = JointState(name=JOINTS, position=[0.1, position, *[0.1] * 4])
            message.header.stamp = messages.ns_to_stamp(STAMP + 10**9 * k)
            tf.on_joint_states(serialize_message(message), 2 + k, 2 + k)
    with Reader(tmp_path / 'bag') as reader:
        found = [STORE.deserialize_cdr(data, x.msgtype) for x, _, data in reader.messages()]
    children = [{x.child_frame_id for x in each.transforms} for each in found]
    assert children[2] - children[0] == children[2] - children[1] == {'link2'}
    assert all(np.isfinite([getattr(x.transform.rotation, axis) for axis in 'xyzw']).all()
               for each in found for x in each.transforms)
