"""A robot's tool weighed from a recording of it at rest, and from a running arm."""

from fake_arm import wrench_message
from foreign_bag import controller_file, JOINTS, RATE, START
from multicontact_control.config import ToolConfig
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CalibrationError
from multicontact_control.experiment.external import read_controller_files
from multicontact_control.experiment.weighing import (
    RestConfig,
    Sample,
    weigh_at_rest,
    weigh_recording,
)
from multicontact_control.nodes import messages, topics
from multicontact_control.sensor.tool import weight_reading
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

pytestmark = pytest.mark.ros

TOOL = ToolConfig(mass=1.3, com_sensor=(0.01, -0.03, 0.07),
                  bias_sensor=(2.0, -1.0, 3.0, 0.1, -0.05, 0.02))
POSES = np.zeros((5, 7))
POSES[:, 3:6] = [[0.9, 0.5, -0.8], [1.4, 0.5, -0.8], [0.4, 0.5, -0.8], [0.9, 1.2, -0.2],
                 [0.9, -0.3, -1.3]]
REST, MOVE = 2.0, 0.8  # s
GRAVITY = np.array([0.0, 0.0, -9.81])


def robot_of(file):
    read = read_controller_files([file])
    return RobotModel(read.config().robot, read.urdf_dir)


def reading_at(robot, q):
    return TOOL.bias_sensor + weight_reading(
        robot.update(q, np.zeros(7)).sensor_pose.rotation_world, TOOL, GRAVITY)


def recorded(folder, file, poses=POSES, *, offset=700_000, touched=()):
    """Record an arm that is led from pose to pose; its sensor has stamps of its own."""
    robot, random = robot_of(file), np.random.default_rng(0)
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        joint_states, wrenches = (writer.add_connection(
            f'/{topic.name}', topic.type_name, typestore=store)
            for topic in (topics.JOINT_STATES, topics.WRENCH))
        for k in range(round(len(poses) * (REST + MOVE) * RATE)):
            number, at = divmod(k / RATE, REST + MOVE)
            here = poses[int(number)]
            there = poses[min(int(number) + 1, len(poses) - 1)]
            q = here + max(at - REST, 0.0) / MOVE * (there - here)
            wrench = reading_at(robot, q) + random.normal(size=6) * ([0.1] * 3 + [0.01] * 3)
            if int(number) in touched:
                wrench[0] += 5.0 * np.sin(7.0 * at)
            stamp = START + round(k / RATE * 1e9)
            writer.write(joint_states, stamp, serialize_message(messages.joint_state_message(
                stamp, JOINTS, position=q, velocity=np.zeros(7))))
            writer.write(wrenches, stamp + offset % 10 ** 9, serialize_message(
                wrench_message(stamp + offset, wrench, 'wrist')))
    return folder


@pytest.mark.parametrize(('offset', 'touched'), [(700_000, (2,)), (3_600_000_000_700_000, ())])
def test_tool_is_found_from_rests_whatever_the_clocks(tmp_path, offset, touched):
    """Stamps of the sensor beside those of the joints, or an hour off; a touched tool left out."""
    file = controller_file(tmp_path)
    found, _ = weigh_recording(
        recorded(tmp_path / 'bag', file, offset=offset, touched=touched), [file])
    assert found.poses == 5 - len(touched)
    assert found.mass == pytest.approx(TOOL.mass, abs=0.01)
    np.testing.assert_allclose(found.com_sensor, TOOL.com_sensor, atol=2e-3)
    np.testing.assert_allclose(found.bias_sensor[:3], TOOL.bias_sensor[:3], atol=0.05)


def test_too_few_rests_or_orientations_are_refused(tmp_path):
    file = controller_file(tmp_path)
    same = POSES[:1].repeat(5, axis=0) + 0.2 * (np.arange(5) % 2)[:, None] * np.eye(7)[6]
    for name, poses in (('few', POSES[:2]), ('same', same)):
        with pytest.raises(CalibrationError):
            weigh_recording(recorded(tmp_path / name, file, poses), [file])


@pytest.fixture
def arm(tmp_path):
    """Return an arm, and a function that makes a source of its samples, every 10 ms."""
    robot = robot_of(controller_file(tmp_path))

    def samples(angle_at):
        ticks = iter(range(1, 10 ** 6))

        def sample():
            time = 0.01 * next(ticks)
            q = POSES[0] + angle_at(time)
            return Sample(time, q, reading_at(robot, q))
        return sample
    return robot, samples


@pytest.mark.parametrize('angle_at', [lambda t: min(0.5 * t, 0.6), lambda t: 0.015 * t])
def test_running_arm_is_weighed_at_its_mean_pose_once_it_rests(arm, angle_at):
    """Taken at the end, the pose of an arm that creeps would be 0.15 N off."""
    robot, samples = arm
    reading = weigh_at_rest(samples(angle_at), robot, RestConfig(), 10.0)
    np.testing.assert_allclose(reading.wrench_sensor - TOOL.bias_sensor, weight_reading(
        reading.rotation_world, TOOL, GRAVITY), atol=0.01)


def test_arm_that_never_rests_is_not_weighed(arm):
    robot, samples = arm
    with pytest.raises(CalibrationError):
        weigh_at_rest(samples(lambda t: 0.3 * np.sin(t)), robot, RestConfig(), 3.0)
