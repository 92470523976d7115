"""Messages read and written as bytes and by class, held against rclpy's own (de)serialisation."""

from __future__ import annotations

import math

from fake_arm import wrench_message
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Transform, Twist
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.errors import MessageError
from multicontact_control.nodes import messages
from multicontact_control.nodes.streams import (
    JOINT_FIELDS,
    MessageTemplate,
    named_reader,
    NamedReading,
    wrench_reader,
)
from multicontact_control.supervision.inputs import JointInput
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

NAMES = ('a', 'b', 'c')
JOINTS = [f'joint{i}' for i in range(6)]
STAMP = 1_795_000_000_123_456_789
NAN, INF = math.nan, math.inf
TEXT = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9)
STAMPS = st.integers(0, 2 ** 31 - 1).flatmap(
    lambda sec: st.integers(0, 999_999_999).map(lambda nano: sec * 10 ** 9 + nano))
FINITE = st.floats(-1e6, 1e6)
NUMBER = st.one_of(st.floats(width=64), FINITE)


@st.composite
def joint_states(draw):
    names = draw(st.lists(TEXT, unique=True, min_size=1, max_size=7))
    lengths = st.one_of(st.just(len(names)), st.integers(0, 8))
    position, velocity, effort = (
        draw(lengths.flatmap(lambda n: st.lists(NUMBER, min_size=n, max_size=n)))
        for _ in range(3))
    header = Header(stamp=messages.ns_to_stamp(draw(STAMPS)), frame_id=draw(TEXT))
    return JointState(
        header=header, name=names, position=position, velocity=velocity, effort=effort)


def joint_state_reader(names):
    return named_reader(names, JOINT_FIELDS, JointInput, ('velocity', 'effort'))


def by_hand(message, names, field):
    """Return the numbers of a field by name, or None where there are none that can be used."""
    values = getattr(message, field)
    if len(values) != len(message.name) or not set(names) <= set(message.name):
        return None
    ours = [values[message.name.index(name)] for name in names]
    return ours if math.isfinite(sum(ours)) else None


def read(reader, message, fields=('q', 'qd', 'effort')):
    """Return stamp and numbers of a reading, or None of all if it is refused."""
    try:
        reading = reader.read(serialize_message(message))
    except MessageError:
        return None
    values = [getattr(reading, name) for name in fields]
    return reading.stamp, *(x if x is None else x.tolist() for x in values)


@settings(max_examples=200, deadline=None)
@given(sent=st.lists(joint_states(), min_size=1, max_size=4), data=st.data())
def test_joint_readers_read_by_name_or_refuse(sent, data):
    """One reader for all: what one message has taught it must not spoil the next."""
    names = data.draw(st.permutations(sent[0].name))
    joints, efforts = joint_state_reader(names), named_reader(names, ('effort',), NamedReading)
    whole = named_reader(names, JOINT_FIELDS, JointInput)
    for message in (*sent, *sent):
        stamp = message.header.stamp.sec * 10 ** 9 + message.header.stamp.nanosec
        q, qd, effort = (by_hand(message, names, x) for x in ('position', 'velocity', 'effort'))
        assert read(joints, message) == (None if q is None else (stamp, q, qd, effort))
        assert read(efforts, message, ('values',)) == (
            None if effort is None else (stamp, effort))
        assert read(whole, message) == (
            None if None in (q, qd, effort) else (stamp, q, qd, effort))


@settings(max_examples=60, deadline=None)
@given(stamp=STAMPS, frame=TEXT, numbers=st.lists(NUMBER, min_size=6, max_size=6))
def test_wrench_reader_reads_every_bit_or_refuses(stamp, frame, numbers):
    message = wrench_message(stamp, numbers, frame)
    reader, expected = wrench_reader(), (stamp, numbers) if math.isfinite(sum(numbers)) else None
    for _ in range(3):
        assert read(reader, message, ('wrench',)) == expected


@pytest.mark.parametrize('effort', [[], [1.0] * 8, [2.0]])
def test_steady_stream_is_read_in_place_and_passes_over_other_joints(effort):
    """A gripper's joints are passed over, whatever their numbers; ours come in our order."""
    reader = joint_state_reader(JOINTS[::-1])
    for k in range(5):
        message = JointState(
            header=Header(stamp=messages.ns_to_stamp(STAMP + k)), name=['f', *JOINTS, 'g'],
            position=[NAN, *np.arange(6.0), INF], velocity=[NAN, *-np.arange(6.0), INF],
            effort=effort)
        reading = reader.read(serialize_message(message))
        assert (reading.stamp, reading.q.tolist()) == (STAMP + k, [5.0, 4.0, 3.0, 2.0, 1.0, 0.0])
        assert reading.qd.tolist() == [-5.0, -4.0, -3.0, -2.0, -1.0, 0.0]
        assert reading.q.flags.aligned and reading.q.flags.c_contiguous
    assert reader.slow == 1


@pytest.mark.parametrize(('field', 'value'), [
    ('name', ['a', 'b', 'd']), ('name', ['a', 'b', 'c', 'a']), ('position', [1.0, 2.0]),
    ('position', [1.0, NAN, 3.0]), ('position', [INF, -INF, 0.0])])
def test_joint_state_reader_refuses_by_field(field, value):
    message = messages.joint_state_message(STAMP, NAMES, position=[1.0] * 3, velocity=[2.0] * 3)
    setattr(message, field, value)
    with pytest.raises(MessageError, match=f'^{field}: expected'):
        joint_state_reader(NAMES).read(serialize_message(message))


def test_wrench_reader_refuses_another_frame_and_takes_none_for_its_own():
    reader = wrench_reader('ft')
    for frame in ('ft', '/ft', 'ft', '', '', ''):
        assert read(reader, wrench_message(STAMP, range(6), frame), ('wrench',)) == (
            STAMP, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    with pytest.raises(MessageError, match='header.frame_id'):
        reader.read(serialize_message(wrench_message(STAMP, range(6), 'tool0')))


def six():
    numbers = np.arange(6.0)
    return messages.joint_state_message(
        STAMP, JOINTS, position=numbers, velocity=-numbers, effort=numbers ** 2)


def test_padding_and_bytes_behind_the_message_do_not_matter():
    """Names of seven bytes with their zero: each is followed by one of padding."""
    raw, reader = bytearray(serialize_message(six())), joint_state_reader(JOINTS)
    reader.read(bytes(raw))
    for name in JOINTS[:-1]:
        raw[raw.index(name.encode()) + 7] = 0xA5
    raw[2:4] = b'\0\3'
    np.testing.assert_array_equal(reader.read(bytes(raw) + b'\xff' * 9).q, np.arange(6.0))
    assert reader.slow == 1


def test_damaged_bytes_are_refused():
    """Cut off, with lengths beyond all memory, and of another representation."""
    raw = serialize_message(six())
    reader = joint_state_reader(JOINTS)
    reader.read(raw)
    damaged = [raw[:length] for length in range(len(raw) - 4)] + [b'\0\7' + raw[2:]] + [
        raw[:at] + b'\xff\xff\xff\x7f' + raw[at + 4:] for at in (12, 24, 28)]
    for data in damaged:
        with pytest.raises(MessageError):
            reader.read(data)


@settings(max_examples=100, deadline=None)
@given(stamp=STAMPS, frame=TEXT, numbers=st.lists(FINITE, min_size=18, max_size=18))
def test_template_writes_what_rclpy_reads(stamp, frame, numbers):
    message = six()
    message.header.frame_id = frame
    data = MessageTemplate(message).write(stamp, *np.reshape(numbers, (3, 6)))
    message.header.stamp = messages.ns_to_stamp(stamp)
    message.position, message.velocity, message.effort = (
        numbers[:6], numbers[6:12], numbers[12:])
    assert deserialize_message(data, JointState) == message


def test_template_writes_poses_wrenches_and_clocks():
    numbers = np.random.default_rng(0).standard_normal(7)
    for message, expected, runs in (
            (PoseStamped(), PoseStamped(
                header=Header(stamp=messages.ns_to_stamp(STAMP)), pose=Pose(
                    position=Point(**dict(zip('xyz', numbers))),
                    orientation=Quaternion(**dict(zip('xyzw', numbers[3:]))))), (numbers,)),
            (wrench_message(0, np.zeros(6), 'ft_face'),
             wrench_message(STAMP, numbers[:6], 'ft_face'), (numbers[:6],)),
            (Clock(), Clock(clock=messages.ns_to_stamp(STAMP)), ())):
        data = MessageTemplate(message).write(STAMP, *runs)
        assert deserialize_message(data, type(message)) == expected


@pytest.mark.parametrize(('stamp', 'number'), [
    (STAMP, NAN), (STAMP, INF), (STAMP, -INF), (2 ** 31 * 10 ** 9, 1.0)])
def test_template_refuses_what_is_not_finite_and_a_stamp_beyond_those_of_ros(stamp, number):
    template = MessageTemplate(six())
    before = template.write(STAMP, np.ones(6), np.ones(6), np.ones(6))
    with pytest.raises(MessageError):
        template.write(stamp, np.ones(6), np.full(6, number), np.ones(6))
    assert template.write(STAMP, np.ones(6), np.ones(6), np.ones(6)) == before


@pytest.mark.parametrize(('names', 'efforts', 'positions', 'expected'), [
    (['c'], [5.0], [], ({'c': 5.0}, {})),
    (['a', 'c'], [], [0.01, -0.02], ({}, {'a': 0.01, 'c': -0.02})),
    (['d'], [1.0], [], None), (['a', 'a'], [1.0, 2.0], [], None), ([], [], [], None),
    (['a'], [], [], None), (['a'], [NAN], [], None), (['a'], [5.0], [0.01], None)])
def test_force_command_has_forces_or_centres_of_some_contacts(
        names, efforts, positions, expected):
    message = JointState(name=names, effort=efforts, position=positions)
    if expected is None:
        with pytest.raises(MessageError):
            messages.read_force_command(message, NAMES)
    else:
        assert messages.read_force_command(message, NAMES) == expected


def motion_point(*, turn=1.0005, height=0.0, poses=1, twists=1):
    point = MultiDOFJointTrajectoryPoint(
        transforms=[Transform()] * poses, velocities=[Twist()] * twists,
        accelerations=[Twist()] * min(twists, 1))
    for pose in point.transforms:
        pose.translation.x, pose.translation.z, pose.rotation.w = 0.5, height, turn
    if twists:
        point.velocities[0].linear.y = 0.1
        point.accelerations[0].angular.z = 0.2
    return point


def test_read_motion_normalises_its_quaternion_and_takes_no_twist_for_rest():
    motion = messages.read_motion(motion_point())
    np.testing.assert_array_equal(motion.position_world, [0.5, 0.0, 0.0])
    np.testing.assert_allclose(motion.quaternion_xyzw, [0.0, 0.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_array_equal(motion.twist_world, [0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(motion.acceleration_world, [0.0, 0.0, 0.0, 0.0, 0.0, 0.2])
    motion = messages.read_motion(motion_point(twists=0))
    assert not motion.twist_world.any() and not motion.acceleration_world.any()


@pytest.mark.parametrize(('spoiled', 'field'), [
    ({'turn': 0.5}, 'rotation'), ({'height': INF}, 'translation'), ({'poses': 0}, 'transforms'),
    ({'twists': 2}, 'velocities')])
def test_read_motion_refuses_by_field(spoiled, field):
    with pytest.raises(MessageError, match=f'^{field}: expected'):
        messages.read_motion(motion_point(**spoiled))


@pytest.mark.parametrize(('build', 'field'), [
    (lambda x: messages.joint_state_message(STAMP, NAMES, effort=[0.0, x, 0.0]), 'effort'),
    (lambda x: messages.joint_state_message(STAMP, NAMES, effort=[1.0, 2.0]), 'effort'),
    (lambda x: messages.motion_message([x] * 3, [0.0] * 4, [0.0] * 6, [0.0] * 6), 'translation'),
    (lambda x: messages.motion_message(
        [0.0] * 3, [0.0] * 4, [0.0] * 5 + [x], [0.0] * 6), 'velocities')])
def test_building_refuses_numbers_that_are_not_finite_and_a_wrong_count(build, field):
    for value in (NAN, INF):
        with pytest.raises(MessageError, match=f'^{field}: expected'):
            build(value)
