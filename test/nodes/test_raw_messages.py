"""Messages read and written as bytes, held against rclpy's own (de)serialisation."""

from __future__ import annotations

import math
import struct

from geometry_msgs.msg import Point, PoseStamped, Vector3, Wrench, WrenchStamped
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
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

STAMP = 1_795_000_000_123_456_789
TEXT = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9)
STAMPS = st.integers(0, 2 ** 31 - 1).flatmap(
    lambda sec: st.integers(0, 999_999_999).map(lambda nano: sec * 10 ** 9 + nano))
FINITE = st.floats(-1e6, 1e6)
NUMBER = st.one_of(st.floats(width=64), FINITE)


def same(a, b):
    """Return whether two arrays are the same in every bit."""
    return a is b is None or np.asarray(a).tobytes() == np.asarray(b).tobytes()


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
        return read(data)
    except MessageError as error:
        return str(error)


def test_joints_among_others_are_read_in_place():
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
        assert found.q.flags.c_contiguous
    assert reader.slow == 1
    message.name = ['f', 'g', 'a', 'b']
    with pytest.raises(MessageError, match=r"name: expected each of \['a', 'b', 'c'\] once"):
        reader.read(serialize_message(message))
    assert reader.slow == 2


def test_efforts_are_measured_again_after_one_that_was_not_a_number():
    reader = joint_state_reader(['a'])
    for effort, seen in ((math.nan, None), (2.0, [2.0]), (math.nan, None), (3.0, [3.0])):
        found = reader.read(serialize_message(messages.JointState(
            name=['a'], position=[0.0], velocity=[0.0], effort=[effort])))
        assert (found.effort if seen is None else found.effort.tolist()) == seen


def test_wrench_of_another_frame_is_refused_and_one_of_none_is_told_once():
    told = []
    reader = wrench_reader('ft', lambda: told.append(1))

    def send(frame):
        return reader.read(serialize_message(
            messages.wrench_message(STAMP, np.arange(6.0), frame)))

    for frame in ('ft', '/ft', 'ft', 'ft'):
        np.testing.assert_array_equal(send(frame).wrench_sensor, np.arange(6.0))
    assert (reader.slow, told) == (3, [])
    for frame in ('', '', ''):
        send(frame)
    assert told == [1]
    with pytest.raises(MessageError, match="header.frame_id: expected 'ft' .*, found 'tool0'"):
        send('tool0')


@settings(max_examples=300, deadline=None)
@given(sent=st.lists(joint_states(), min_size=1, max_size=4), repeat=st.booleans(),
       data=st.data())
def test_joint_states_are_read_as_rclpy_reads_them(sent, repeat, data):
    """One reader for all: what one message has taught it must not spoil the next."""
    names = data.draw(st.permutations(sent[0].name))
    reader = joint_state_reader(names)
    for message in (*sent, *sent) if repeat else sent:
        raw = serialize_message(message)
        found = outcome(reader.read, raw)
        expected = outcome(lambda raw: messages.read_joint_state(
            deserialize_message(raw, JointState), names), raw)
        if isinstance(expected, str) or isinstance(found, str):
            assert found == expected
        else:
            assert found.stamp == expected.stamp
            assert same(found.q, expected.q) and same(found.qd, expected.qd)
            assert (found.effort is None) == (expected.effort is None)
            assert found.effort is None or same(found.effort, expected.effort)


@settings(max_examples=100, deadline=None)
@given(message=joint_states(FINITE), again=joint_states(FINITE))
def test_efforts_and_innovations_are_read_as_rclpy_reads_them(message, again):
    for make, read in ((effort_reader, messages.read_effort),
                       (innovation_reader, messages.read_innovation)):
        reader = make(message.name)
        for each in (message, message, again, message):
            raw = serialize_message(each)
            assert repr(outcome(reader.read, raw)) == repr(outcome(
                lambda raw, read=read: read(deserialize_message(raw, JointState), message.name),
                raw))


@settings(max_examples=100, deadline=None)
@given(stamp=STAMPS, frame=TEXT, numbers=st.lists(NUMBER, min_size=6, max_size=6))
def test_wrenches_are_read_as_rclpy_reads_them(stamp, frame, numbers):
    force, torque = (Vector3(x=x, y=y, z=z) for x, y, z in (numbers[:3], numbers[3:]))
    raw = serialize_message(WrenchStamped(
        header=Header(stamp=messages.ns_to_stamp(stamp), frame_id=frame),
        wrench=Wrench(force=force, torque=torque)))
    reader = wrench_reader()
    for _ in range(3):
        assert repr(outcome(reader.read, raw)) == repr(outcome(
            lambda raw: messages.read_wrench(deserialize_message(raw, WrenchStamped)), raw))


def good(stamp=STAMP, **changes):
    numbers = np.arange(6.0)
    message = messages.joint_state_message(
        stamp, [f'joint{i}' for i in range(6)], position=numbers, velocity=-numbers,
        effort=numbers ** 2, frame_id='base')
    for name, value in changes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize('effort', [[], [1.0] * 6, [2.0]])
def test_a_steady_stream_is_read_in_place(effort):
    reader = joint_state_reader(good().name)
    for k in range(5):
        reading = reader.read(serialize_message(good(STAMP + k, effort=effort)))
        assert reading.stamp == STAMP + k
        assert reading.q.flags.aligned and reading.q.flags.c_contiguous
    assert reader.slow == 1


def test_a_stream_in_another_order_is_read_rightly_and_counted():
    reader = joint_state_reader(good().name)
    reader.read(serialize_message(good()))
    shuffled = good(name=['joint5', *good().name[:5]])
    np.testing.assert_array_equal(reader.read(serialize_message(shuffled)).q[5], 0.0)
    assert reader.slow == 2
    shuffled.velocity[0] = 1.0
    assert reader.read(serialize_message(shuffled)).qd[5] == 1.0
    assert reader.slow == 2, 'the other order is known'
    for _ in range(2):
        reader.read(serialize_message(good()))
    assert reader.slow == 3


def test_what_fills_up_the_end_and_the_gaps_does_not_matter():
    raw = bytearray(serialize_message(good()))
    places = find_places(JointState, bytes(raw))
    used = {*range(4), *range(places.stamp, places.stamp + 8)}
    for start, stop in places.constants:
        used |= {*range(start, stop)}
    for start, count in places.numbers:
        used |= {*range(start, start + 8 * count)}
    gaps = sorted({*range(places.end)} - used)
    assert gaps, 'a name of seven bytes is followed by one of padding'
    reader = joint_state_reader(good().name)
    reader.read(bytes(raw))
    for gap in gaps:
        raw[gap] = 0xA5
    raw[2:4] = b'\0\3'
    np.testing.assert_array_equal(reader.read(bytes(raw) + b'\xff' * 9).q, np.arange(6.0))
    assert reader.slow == 1


def big_endian(stamp, names, position, velocity):
    """Return a JointState as a machine of the other byte order sends it."""
    body = bytearray(struct.pack('>iI', *divmod(stamp, 10 ** 9)))

    def align(size):
        body.extend(bytes(-len(body) % size))

    def text(value):
        align(4)
        body.extend(struct.pack('>I', len(value) + 1) + value.encode() + b'\0')

    text('')
    align(4)
    body.extend(struct.pack('>I', len(names)))
    for name in names:
        text(name)
    for numbers in (position, velocity, []):
        align(4)
        body.extend(struct.pack('>I', len(numbers)))
        if numbers:
            align(8)
            body.extend(struct.pack(f'>{len(numbers)}d', *numbers))
    return b'\0\0\0\0' + bytes(body)


def test_the_other_byte_order_is_read_rightly_and_never_in_place():
    names = ['joint1', 'b']
    raw = big_endian(STAMP, names, [1.5, -2.0], [3.0, 4.25])
    reader = joint_state_reader(names)
    for _ in range(2):
        reading = reader.read(raw)
        assert (reading.stamp, reading.q.tolist(), reading.qd.tolist()) == (
            STAMP, [1.5, -2.0], [3.0, 4.25])
    assert reader.slow == 2


@pytest.mark.parametrize('make', [
    lambda: joint_state_reader(good().name), lambda: effort_reader(good().name)])
def test_whatever_is_cut_off_is_refused(make):
    raw = serialize_message(good())
    reader = make()
    reader.read(raw)
    for length in range(find_places(JointState, raw).end):
        with pytest.raises(MessageError):
            reader.read(raw[:length])


def test_a_length_that_cannot_be_is_refused_without_memory_for_it():
    raw = bytearray(serialize_message(good()))
    for start, stop in find_places(JointState, bytes(raw)).constants:
        if stop - start == 4:
            damaged = raw[:]
            damaged[start:stop] = b'\xff\xff\xff\x7f'
            with pytest.raises(MessageError, match='data: expected at least'):
                joint_state_reader(good().name).read(bytes(damaged))


def test_bytes_of_another_representation_are_refused():
    raw = serialize_message(good())
    with pytest.raises(MessageError, match='encapsulation: expected CDR'):
        joint_state_reader(good().name).read(b'\0\7' + raw[2:])


@settings(max_examples=200, deadline=None)
@given(stamp=STAMPS, frame=TEXT, numbers=st.lists(FINITE, min_size=18, max_size=18))
def test_what_is_written_is_what_rclpy_reads(stamp, frame, numbers):
    q, qd, effort = np.reshape(numbers, (3, 6))
    example = messages.joint_state_message(
        0, good().name, position=np.ones(6), velocity=np.ones(6), effort=np.ones(6),
        frame_id=frame)
    found = deserialize_message(MessageTemplate(example).write(stamp, q, qd, effort), JointState)
    assert found == messages.joint_state_message(
        stamp, good().name, position=q, velocity=qd, effort=effort, frame_id=frame)


def test_poses_and_wrenches_are_written_as_rclpy_writes_them():
    numbers = np.random.default_rng(0).standard_normal(7)
    pose = MessageTemplate(messages.pose_message(0, np.zeros(3), np.zeros(4), 'world'))
    assert deserialize_message(pose.write(STAMP, numbers), PoseStamped) == (
        messages.pose_message(STAMP, numbers[:3], numbers[3:], 'world'))
    wrench = MessageTemplate(messages.wrench_message(0, np.zeros(6), 'ft_face'))
    assert deserialize_message(wrench.write(STAMP, numbers[:6]), WrenchStamped) == (
        messages.wrench_message(STAMP, numbers[:6], 'ft_face'))


def test_a_clock_has_no_numbers_but_its_time():
    template = MessageTemplate(Clock())
    assert deserialize_message(template.write(STAMP), Clock) == Clock(
        clock=messages.ns_to_stamp(STAMP))


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_not_written(bad):
    template = MessageTemplate(good())
    before = template.write(STAMP, np.ones(6), np.ones(6), np.ones(6))
    with pytest.raises(MessageError, match='finite'):
        template.write(STAMP + 1, np.ones(6), np.full(6, bad), np.ones(6))
    assert template.write(STAMP, np.ones(6), np.ones(6), np.ones(6)) == before


def test_a_stamp_beyond_those_of_ros_is_not_written():
    with pytest.raises(MessageError, match='stamp.sec'):
        MessageTemplate(good()).write(2 ** 31 * 10 ** 9, np.ones(6), np.ones(6), np.ones(6))


def test_a_template_reads_what_it_wrote():
    template = MessageTemplate(good())
    stamp, (q, qd, effort) = template.read(template.write(7, np.ones(6), np.zeros(6), -np.ones(6)))
    assert (stamp, q.tolist(), qd.tolist(), effort.tolist()) == (
        7, [1.0] * 6, [0.0] * 6, [-1.0] * 6)
