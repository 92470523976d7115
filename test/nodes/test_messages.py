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


def joint_state(**changes):
    message = messages.joint_state_message(
        STAMP, NAMES, position=[1.0, 2.0, 3.0], velocity=[4.0, 5.0, 6.0], effort=[7.0, 8.0, 9.0])
    for key, value in changes.items():
        setattr(message, key, value)
    return message


@pytest.mark.parametrize('nanoseconds', [0, 1, 999_999_999, 1_000_000_000, STAMP])
def test_stamp_round_trip_is_exact(nanoseconds):
    assert messages.stamp_to_ns(messages.ns_to_stamp(nanoseconds)) == nanoseconds


def test_joint_state_keeps_every_bit_over_the_wire():
    rng = np.random.default_rng(1)
    q, qd = rng.standard_normal(3) * 1e-7, rng.standard_normal(3) * 1e7
    sent = messages.joint_state_message(STAMP, NAMES, position=q, velocity=qd)
    reading = messages.read_joint_state(
        deserialize_message(serialize_message(sent), JointState), NAMES)
    assert reading.stamp == STAMP
    assert reading.q.tobytes() == q.tobytes()
    assert reading.qd.tobytes() == qd.tobytes()


def test_wrench_keeps_every_bit_force_first():
    wrench = np.random.default_rng(2).standard_normal(6)
    message = messages.wrench_message(STAMP, wrench, 'ft_face')
    assert message.header.frame_id == 'ft_face'
    assert message.wrench.force.x == wrench[0]
    reading = messages.read_wrench(message)
    assert (reading.stamp, reading.wrench_sensor.tobytes()) == (STAMP, wrench.tobytes())


def test_read_joint_state_follows_names_not_places():
    reading = messages.read_joint_state(joint_state(), ('c', 'a', 'b'))
    np.testing.assert_array_equal(reading.q, [3.0, 1.0, 2.0])
    np.testing.assert_array_equal(reading.qd, [6.0, 4.0, 5.0])


@pytest.mark.parametrize(('changes', 'match'), [
    ({'name': ['a', 'b']}, r"name: expected each of \['a', 'b', 'c'\] once, found \['a', 'b'\]"),
    ({'name': ['a', 'b', 'd']}, r"name: expected .*'c'\] once, found .*'d'\]"),
    ({'name': ['a', 'b', 'b']}, 'name: expected'),
    ({'position': [1.0, 2.0]}, 'position: expected 3 values, found 2'),
    ({'velocity': []}, 'velocity: expected 3 values, found 0'),
    ({'position': [1.0, float('nan'), 3.0]}, 'position: expected finite numbers, found'),
    ({'velocity': [float('inf'), -float('inf'), 0.0]}, 'velocity: expected finite numbers'),
])
def test_read_joint_state_refuses(changes, match):
    with pytest.raises(MessageError, match=match):
        messages.read_joint_state(joint_state(**changes), NAMES)


def test_message_error_has_one_cause_whatever_was_found():
    causes = set()
    for value in (float('nan'), float('inf')):
        with pytest.raises(MessageError) as caught:
            messages.read_effort(joint_state(effort=[value, 0.0, 0.0]), NAMES)
        causes.add(caught.value.cause)
    assert len(causes) == 1


def test_read_force_command_takes_a_part_of_the_names():
    message = messages.joint_state_message(STAMP, ['c'], effort=[5.0])
    assert messages.read_force_command(message, NAMES) == ({'c': 5.0}, {})


def test_positions_of_a_force_command_are_centres_of_pressure():
    message = messages.joint_state_message(0, ['a', 'c'], position=[0.01, -0.02])
    assert messages.read_force_command(message, NAMES) == ({}, {'a': 0.01, 'c': -0.02})


@pytest.mark.parametrize(('names', 'efforts'), [
    (['d'], [1.0]), (['a', 'a'], [1.0, 2.0]), ([], []), (['a'], []), (['a'], [float('nan')])])
def test_read_force_command_refuses(names, efforts):
    message = JointState(name=names, effort=efforts)
    with pytest.raises(MessageError):
        messages.read_force_command(message, NAMES)


def test_read_force_command_refuses_forces_and_centres_in_one_message():
    message = messages.joint_state_message(0, ['a', 'c'], position=[0.01, 0.0], effort=[5.0] * 2)
    with pytest.raises(MessageError, match='position: expected none beside efforts: centres'):
        messages.read_force_command(message, NAMES)


def test_read_wrench_refuses_what_is_not_finite():
    message = messages.wrench_message(STAMP, np.zeros(6), '')
    message.wrench.torque.y = float('nan')
    with pytest.raises(MessageError, match='wrench: expected finite numbers'):
        messages.read_wrench(message)


def motion_point():
    point = MultiDOFJointTrajectoryPoint(
        transforms=[Transform()], velocities=[Twist()], accelerations=[Twist()])
    point.transforms[0].translation.x = 0.5
    point.transforms[0].rotation.w = 1.0005
    point.velocities[0].linear.y = 0.1
    point.accelerations[0].angular.z = 0.2
    return point


def test_read_motion_normalises_its_quaternion():
    motion = messages.read_motion(motion_point())
    np.testing.assert_array_equal(motion.position_world, [0.5, 0.0, 0.0])
    np.testing.assert_allclose(motion.quaternion_xyzw, [0.0, 0.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_array_equal(motion.twist_world, [0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(motion.acceleration_world, [0.0, 0.0, 0.0, 0.0, 0.0, 0.2])


def test_read_motion_without_derivatives_is_at_rest():
    point = motion_point()
    point.velocities, point.accelerations = [], []
    motion = messages.read_motion(point)
    assert not motion.twist_world.any()
    assert not motion.acceleration_world.any()


def break_rotation(point):
    point.transforms[0].rotation.w = 0.5


def break_position(point):
    point.transforms[0].translation.z = float('inf')


def break_count(point):
    point.transforms = []


def break_twist(point):
    point.velocities = [Twist(), Twist()]


@pytest.mark.parametrize(('spoil', 'match'), [
    (break_rotation, 'rotation: expected a quaternion of unit length, found length 0.5'),
    (break_position, 'translation: expected finite numbers'),
    (break_count, 'transforms: expected one pose, found 0'),
    (break_twist, 'velocities: expected at most one, found 2')])
def test_read_motion_refuses(spoil, match):
    point = motion_point()
    spoil(point)
    with pytest.raises(MessageError, match=match):
        messages.read_motion(point)


@pytest.mark.parametrize('build', [
    lambda x: messages.joint_state_message(STAMP, NAMES, effort=[0.0, x, 0.0]),
    lambda x: messages.wrench_message(STAMP, [0.0, 0.0, x, 0.0, 0.0, 0.0], ''),
    lambda x: messages.pose_message(STAMP, [x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], ''),
    lambda x: messages.pose_message(STAMP, [0.0, 0.0, 0.0], [x, 0.0, 0.0, 1.0], '')])
@pytest.mark.parametrize('value', [float('nan'), float('inf'), -float('inf')])
def test_building_never_puts_out_what_is_not_finite(build, value):
    with pytest.raises(MessageError, match='expected finite numbers'):
        build(value)


def test_building_refuses_a_wrong_count():
    with pytest.raises(MessageError, match='effort: expected 3 values, found 2'):
        messages.joint_state_message(STAMP, NAMES, effort=[1.0, 2.0])
