"""Converters between messages and arrays, without a node."""

from geometry_msgs.msg import Transform, Twist
from multicontact_control.errors import MessageError
from multicontact_control.nodes import messages
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

NAMES = ('a', 'b', 'c')
STAMP = 1_795_000_000_123_456_789
NAN, INF = float('nan'), float('inf')


def joint_state(**changes):
    message = messages.joint_state_message(
        STAMP, NAMES, position=[1.0, 2.0, 3.0], velocity=[4.0, 5.0, 6.0], effort=[7.0, 8.0, 9.0])
    for key, value in changes.items():
        setattr(message, key, value)
    return message


@pytest.mark.parametrize('nanoseconds', [0, 1, 999_999_999, 1_000_000_000, STAMP])
def test_stamp_round_trip_is_exact(nanoseconds):
    assert messages.stamp_to_ns(messages.ns_to_stamp(nanoseconds)) == nanoseconds


def test_joint_state_and_wrench_keep_every_bit_over_the_wire():
    rng = np.random.default_rng(1)
    q, qd, wrench = rng.standard_normal(3) * 1e-7, rng.standard_normal(3) * 1e7, rng.random(6)
    sent = messages.joint_state_message(STAMP, NAMES, position=q, velocity=qd)
    reading = messages.read_joint_state(
        deserialize_message(serialize_message(sent), JointState), NAMES)
    assert (reading.stamp, reading.q.tobytes(), reading.qd.tobytes(), reading.effort) == (
        STAMP, q.tobytes(), qd.tobytes(), None)
    message = messages.wrench_message(STAMP, wrench, 'ft_face')
    assert (message.header.frame_id, message.wrench.force.x) == ('ft_face', wrench[0])
    reading = messages.read_wrench(message)
    assert (reading.stamp, reading.wrench_sensor.tobytes()) == (STAMP, wrench.tobytes())


def test_read_joint_state_follows_names_not_places():
    reading = messages.read_joint_state(joint_state(), ('c', 'a', 'b'))
    np.testing.assert_array_equal(reading.q, [3.0, 1.0, 2.0])
    np.testing.assert_array_equal(reading.qd, [6.0, 4.0, 5.0])


@pytest.mark.parametrize(('field', 'value'), [
    ('name', ['a', 'b']), ('name', ['a', 'b', 'd']), ('name', ['a', 'b', 'c', 'a']),

    ('position', [1.0, 2.0]), ('velocity', []), ('position', [1.0, NAN, 3.0]),
    ('velocity', [INF, -INF, 0.0])])
def test_read_joint_state_refuses_by_field(field, value):
    with pytest.raises(MessageError, match=f'^{field}: expected'):
        messages.read_joint_state(joint_state(**{field: value}), NAMES)


def test_read_force_command_takes_forces_or_centres_of_some_contacts():
    message = messages.joint_state_message(STAMP, ['c'], effort=[5.0])
    assert messages.read_force_command(message, NAMES) == ({'c': 5.0}, {})
    message = messages.joint_state_message(0, ['a', 'c'], position=[0.01, -0.02])
    assert messages.read_force_command(message, NAMES) == ({}, {'a': 0.01, 'c': -0.02})


@pytest.mark.parametrize(('names', 'efforts', 'positions'), [
    (['d'], [1.0], []), (['a', 'a'], [1.0, 2.0], []), ([], [], []), (['a'], [], []),
    (['a'], [NAN], []), (['a'], [5.0], [0.01])])
def test_read_force_command_refuses(names, efforts, positions):
    with pytest.raises(MessageError):
        messages.read_force_command(
            JointState(name=names, effort=efforts, position=positions), NAMES)


def test_read_wrench_refuses_what_is_not_finite():
    message = messages.wrench_message(STAMP, np.zeros(6), '')
    message.wrench.torque.y = NAN
    with pytest.raises(MessageError, match='wrench'):
        messages.read_wrench(message)


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


@pytest.mark.parametrize('build', [
    lambda x: messages.joint_state_message(STAMP, NAMES, effort=[0.0, x, 0.0]),
    lambda x: messages.wrench_message(STAMP, [0.0, 0.0, x, 0.0, 0.0, 0.0], ''),
    lambda x: messages.pose_message(STAMP, [x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], ''),
    lambda x: messages.pose_message(STAMP, [0.0, 0.0, 0.0], [x, 0.0, 0.0, 1.0], '')])
def test_building_refuses_numbers_that_are_not_finite(build):
    for value in (NAN, INF, -INF):
        with pytest.raises(MessageError):
            build(value)


def test_building_refuses_a_wrong_count():
    with pytest.raises(MessageError, match='^effort: expected 3 values, found 2'):
        messages.joint_state_message(STAMP, NAMES, effort=[1.0, 2.0])
