"""Messages read and written as bytes, held against rclpy's own (de)serialisation."""

from __future__ import annotations

import math

from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.errors import MessageError
from multicontact_control.nodes import messages
from multicontact_control.nodes.raw_messages import (
    effort_reader,
    innovation_reader,
    joint_state_reader,
    MessageTemplate,
    wrench_reader,
)
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

STAMP = 1_795_000_000_123_456_789
JOINTS = [f'joint{i}' for i in range(6)]
TEXT = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9)
STAMPS = st.integers(0, 2 ** 31 - 1).flatmap(
    lambda sec: st.integers(0, 999_999_999).map(lambda nano: sec * 10 ** 9 + nano))
FINITE = st.floats(-1e6, 1e6)
NUMBER = st.one_of(st.floats(width=64), FINITE)


@st.composite
def joint_states(draw, numbers=NUMBER):
    names = draw(st.lists(TEXT, unique=True, max_size=7))
    lengths = st.one_of(st.just(len(names)), st.integers(0, 8))
    position, velocity, effort = (
        draw(lengths.flatmap(lambda n: st.lists(numbers, min_size=n, max_size=n)))
        for _ in range(3))
    header = Header(stamp=messages.ns_to_stamp(draw(STAMPS)), frame_id=draw(TEXT))
    return JointState(
        header=header, name=names, position=position, velocity=velocity, effort=effort)


def outcome(read, data):
    """Return what a reader makes of bytes, or how it refuses them."""
    try:
        return repr(read(data))
    except MessageError as error:
        return str(error)


def good(stamp=STAMP, **changes):
    numbers = np.arange(6.0)
    message = messages.joint_state_message(
        stamp, JOINTS, position=numbers, velocity=-numbers, effort=numbers ** 2, frame_id='base')
    for name, value in changes.items():
        setattr(message, name, value)
    return message


@settings(max_examples=200, deadline=None)
@given(sent=st.lists(joint_states(), min_size=1, max_size=4), repeat=st.booleans(),
       data=st.data())
def test_joint_state_reader_reads_as_rclpy_does(sent, repeat, data):
    """One reader for all: what one message has taught it must not spoil the next."""
    names = data.draw(st.permutations(sent[0].name))
    reader = joint_state_reader(names)
    for message in (*sent, *sent) if repeat else sent:
        raw = serialize_message(message)
        assert outcome(reader.read, raw) == outcome(lambda raw: messages.read_joint_state(
            deserialize_message(raw, JointState), names), raw)


@settings(max_examples=60, deadline=None)
@given(message=joint_states(FINITE), again=joint_states(FINITE), data=st.data())
def test_effort_and_innovation_readers_read_as_rclpy_does(message, again, data):
    names = data.draw(st.permutations(message.name))
    for make, read in ((effort_reader, messages.read_effort),
                       (innovation_reader, messages.read_innovation)):
        reader = make(names)
        for each in (message, message, again, message):
            raw = serialize_message(each)
            assert outcome(reader.read, raw) == outcome(
                lambda raw, read=read: read(deserialize_message(raw, JointState), names), raw)


@settings(max_examples=60, deadline=None)
@given(stamp=STAMPS, frame=TEXT, numbers=st.lists(NUMBER, min_size=6, max_size=6))
def test_wrench_reader_reads_as_rclpy_does(stamp, frame, numbers):
    force, torque = (Vector3(x=x, y=y, z=z) for x, y, z in (numbers[:3], numbers[3:]))
    raw = serialize_message(WrenchStamped(
        header=Header(stamp=messages.ns_to_stamp(stamp), frame_id=frame),
        wrench=Wrench(force=force, torque=torque)))
    reader = wrench_reader()
    for _ in range(3):
        assert outcome(reader.read, raw) == outcome(
            lambda raw: messages.read_wrench(deserialize_message(raw, WrenchStamped)), raw)


def test_joint_state_reader_passes_over_other_joints_in_place():
    """A gripper's joints are passed over, whatever their numbers; ours come in our order."""
    reader = joint_state_reader(['a', 'b', 'c'])
    for k in range(4):
        message = JointState(
            header=Header(stamp=messages.ns_to_stamp(STAMP + k)), name=['f', 'c', 'a', 'b'],
            position=[math.nan, 3.0 + k, 1.0, 2.0], velocity=[0.0, 30.0, 10.0, 20.0],
            effort=[math.inf, 300.0, 100.0, 200.0])
        found = reader.read(serialize_message(message))
        assert found.stamp == STAMP + k
        assert found.q.tolist() == [1.0, 2.0, 3.0 + k]
        assert found.qd.tolist() == [10.0, 20.0, 30.0]
        assert found.effort.tolist() == [100.0, 200.0, 300.0]
    assert reader.slow == 1
    message.name = ['f', 'g', 'a', 'b']
    with pytest.raises(MessageError):
        reader.read(serialize_message(message))


def test_wrench_reader_refuses_another_frame_and_reports_a_missing_one_once():
    told = []
    reader = wrench_reader('ft', lambda: told.append(1))

    def send(frame):
        return reader.read(serialize_message(
            messages.wrench_message(STAMP, np.arange(6.0), frame)))

    for frame in ('ft', '/ft', 'ft', '', '', ''):
        np.testing.assert_array_equal(send(frame).wrench_sensor, np.arange(6.0))
    assert told == [1]
    with pytest.raises(MessageError, match='header.frame_id'):
        send('tool0')


@pytest.mark.parametrize('effort', [[], [1.0] * 6, [2.0]])
def test_steady_stream_is_read_in_place(effort):
    reader = joint_state_reader(JOINTS)
    for k in range(5):
        reading = reader.read(serialize_message(good(STAMP + k, effort=effort)))
        assert reading.stamp == STAMP + k
        assert reading.q.flags.aligned and reading.q.flags.c_contiguous
    assert reader.slow == 1


def test_padding_and_bytes_behind_the_message_do_not_matter():
    """Names of seven bytes with their zero: each is followed by one of padding."""
    raw, reader = bytearray(serialize_message(good())), joint_state_reader(JOINTS)
    reader.read(bytes(raw))
    for name in JOINTS[:-1]:
        raw[raw.index(name.encode()) + 7] = 0xA5
    raw[2:4] = b'\0\3'
    np.testing.assert_array_equal(reader.read(bytes(raw) + b'\xff' * 9).q, np.arange(6.0))
    assert reader.slow == 1


@pytest.mark.parametrize('make', [joint_state_reader, effort_reader])
def test_damaged_bytes_are_refused(make):
    """Cut off, with lengths beyond all memory, and of another representation."""
    raw = serialize_message(good())
    reader = make(JOINTS)
    reader.read(raw)
    damaged = [raw[:length] for length in range(len(raw) - 4)] + [b'\0\7' + raw[2:]] + [
        raw[:at] + b'\xff\xff\xff\x7f' + raw[at + 4:] for at in (12, 24, 28)]
    for data in damaged:
        with pytest.raises(MessageError):
            reader.read(data)


@settings(max_examples=100, deadline=None)
@given(stamp=STAMPS, frame=TEXT, numbers=st.lists(FINITE, min_size=18, max_size=18))
def test_template_writes_what_rclpy_reads(stamp, frame, numbers):
    q, qd, effort = np.reshape(numbers, (3, 6))
    template = MessageTemplate(good(0, header=Header(frame_id=frame)))
    data = template.write(stamp, q, qd, effort)
    assert deserialize_message(data, JointState) == messages.joint_state_message(
        stamp, JOINTS, position=q, velocity=qd, effort=effort, frame_id=frame)
    read_stamp, runs = template.read(data)
    assert read_stamp == stamp and np.array(runs).tolist() == [*map(list, (q, qd, effort))]


def test_template_writes_poses_wrenches_and_clocks():
    numbers = np.random.default_rng(0).standard_normal(7)
    for message, expected, runs in (
            (messages.pose_message(0, np.zeros(3), np.zeros(4), 'world'),
             messages.pose_message(STAMP, numbers[:3], numbers[3:], 'world'), (numbers,)),
            (messages.wrench_message(0, np.zeros(6), 'ft_face'),
             messages.wrench_message(STAMP, numbers[:6], 'ft_face'), (numbers[:6],)),
            (Clock(), Clock(clock=messages.ns_to_stamp(STAMP)), ())):
        data = MessageTemplate(message).write(STAMP, *runs)
        assert deserialize_message(data, type(message)) == expected


@pytest.mark.parametrize(('stamp', 'number'), [
    (STAMP, math.nan), (STAMP, math.inf), (STAMP, -math.inf), (2 ** 31 * 10 ** 9, 1.0)])
def test_template_refuses_what_is_not_finite_and_a_stamp_beyond_those_of_ros(stamp, number):
    template = MessageTemplate(good())
    before = template.write(STAMP, np.ones(6), np.ones(6), np.ones(6))
    with pytest.raises(MessageError):
        template.write(stamp, np.ones(6), np.full(6, number), np.ones(6))
    assert template.write(STAMP, np.ones(6), np.ones(6), np.ones(6)) == before
