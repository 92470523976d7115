"""Messages as text, against what `ros2 topic echo` of ROS 2 Jazzy prints."""

from geometry_msgs.msg import PoseStamped, Wrench
from multicontact_control.errors import ConfigError
from multicontact_control.tools.echo import document
import numpy as np
import pytest
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, String
import yaml

JOINTS = """header:
  stamp:
    sec: 1
    nanosec: 2
  frame_id: ''
name:
- a
- b
position:
- 1.0
- -2.5e-07
velocity: []
effort:
- .nan
- 0.0
---"""


def joints():
    message = JointState(name=['a', 'b'], position=[1.0, -2.5e-7], effort=[float('nan'), 0.0])
    message.header.stamp.sec, message.header.stamp.nanosec = 1, 2
    return message


def test_document_is_what_ros2_prints():
    assert document(joints()) == JOINTS


@pytest.mark.parametrize(('field', 'text'), [
    ('header.stamp', 'sec: 1\nnanosec: 2\n---'), ('header.stamp.sec', '1\n---'),
    ('name', "['a', 'b']\n---"), ('position', "array('d', [1.0, -2.5e-07])\n---")])
def test_document_of_a_field_is_what_ros2_prints(field, text):
    assert document(joints(), field) == text


@pytest.mark.parametrize(('field', 'match'), [
    ('efort', "--field: expected one of header, name, position, velocity, effort, found 'efort'"),
    ('name.x', "--field: expected one of no further fields, found 'x'")])
def test_document_names_the_fields_there_are(field, match):
    with pytest.raises(ConfigError, match=match):
        document(joints(), field)


def test_document_cuts_what_is_long_unless_told_otherwise():
    message = Float64MultiArray(data=[0.5] * 200)
    cut = yaml.safe_load(document(message).removesuffix('---'))
    assert cut['data'] == [0.5] * 128 + ['...']
    assert yaml.safe_load(document(message, truncate=None)[:-3])['data'] == [0.5] * 200
    assert document(String(data='x' * 200)) == f'data: {"x" * 128}...\n---'


@pytest.mark.parametrize('message', [
    PoseStamped(), Wrench(), PointCloud2(data=b'\x01\xff'), JointState(effort=np.ones(3))])
def test_document_of_any_message_is_yaml(message):
    read = yaml.safe_load(document(message).removesuffix('---'))
    assert list(read) == list(message.get_fields_and_field_types())
