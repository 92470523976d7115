"""A robot's tool weighed from what somebody recorded of it at rest."""

from foreign_bag import controller_file, JOINTS, RATE, START
from multicontact_control.cli import app
from multicontact_control.config import read_parameters, ToolConfig
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import CalibrationError, ConfigError, RunError
from multicontact_control.experiment.external import read_controller_files
from multicontact_control.experiment.weighing import (
    find_rests,
    RestConfig,
    Sample,
    weigh_at_rest,
    weigh_recording,
)
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.bag import Bag
from multicontact_control.sensor.weight import weight_reading
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from typer.testing import CliRunner

pytestmark = pytest.mark.ros

TOOL = ToolConfig(mass=1.3, com_sensor=(0.01, -0.03, 0.07),
                  bias_sensor=(2.0, -1.0, 3.0, 0.1, -0.05, 0.02))
POSES = np.zeros((5, 7))
POSES[:, 3:6] = [[0.9, 0.5, -0.8], [1.4, 0.5, -0.8], [0.4, 0.5, -0.8], [0.9, 1.2, -0.2],
                 [0.9, -0.3, -1.3]]
REST, MOVE = 2.0, 0.8  # s


def recorded(folder, file, poses=POSES, *, offset=700_000, touched=()):
    """Record an arm that is led from pose to pose; its sensor has stamps of its own."""
    read = read_controller_files([file])
    robot = RobotModel(read.config().robot, read.urdf_dir)
    random, gravity = np.random.default_rng(0), np.array([0.0, 0.0, -9.81])
    with Bag(folder) as writer:
        for topic in (topics.JOINT_STATES, topics.WRENCH):
            writer.add_topic(f'/{topic.name}', topic.type_name, topic.profile)
        for k in range(round(len(poses) * (REST + MOVE) * RATE)):
            number, at = divmod(k / RATE, REST + MOVE)
            here = poses[int(number)]
            there = poses[min(int(number) + 1, len(poses) - 1)]
            q = here + max(at - REST, 0.0) / MOVE * (there - here)
            wrench = weight_reading(
                robot.update(q, np.zeros(7)).sensor_pose.rotation_world, TOOL, gravity)
            wrench = wrench + TOOL.bias_sensor + random.normal(size=6) * ([0.1] * 3 + [0.01] * 3)
            if int(number) in touched:
                wrench[0] += 5.0 * np.sin(7.0 * at)
            stamp = START + round(k / RATE * 1e9)
            for topic, message, late in (
                    (topics.JOINT_STATES, messages.joint_state_message(
                        stamp, JOINTS, position=q, velocity=np.zeros(7)), 0),
                    (topics.WRENCH, messages.wrench_message(
                        stamp + offset, wrench, 'wrist'), offset)):
                writer.write(f'/{topic.name}', serialize_message(message), stamp + late % 10 ** 9)
    return folder


@pytest.mark.parametrize('offset', [700_000, 3_600_000_000_700_000])
def test_tool_is_found_from_rests_whatever_the_clocks(tmp_path, offset):
    """Stamps of the sensor that never are those of the joints, or are an hour off."""
    file = controller_file(tmp_path)
    found, remarks = weigh_recording(recorded(tmp_path / 'bag', file, offset=offset), [file])
    assert found.poses == 5 and len(remarks) == 5
    assert found.mass == pytest.approx(TOOL.mass, abs=0.01)
    np.testing.assert_allclose(found.com_sensor, TOOL.com_sensor, atol=1e-3)
    np.testing.assert_allclose(found.bias_sensor[:3], TOOL.bias_sensor[:3], atol=0.05)


def test_command_leaves_the_rest_in_which_the_tool_was_touched_out(tmp_path):
    file = controller_file(tmp_path)
    bag = recorded(tmp_path / 'bag', file, touched=(2,))
    result = CliRunner().invoke(app, [
        'calibrate', '--from-bag', str(bag), '--controller', str(file), '--out', str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert 'left out: readings with standard deviations of 3.' in result.output
    assert '4 poses' in result.output and 'truth' not in result.output
    tool = read_parameters(tmp_path / 'tool.yaml')['tool']
    assert tool['mass'] == pytest.approx(TOOL.mass, abs=0.02)


def test_too_few_rests_and_missing_topics_are_named(tmp_path):
    file = controller_file(tmp_path)
    with pytest.raises(CalibrationError, match='at least 4 rests of 1.5 s, found 2; rest from'):
        weigh_recording(recorded(tmp_path / 'bag', file, POSES[:2]), [file])
    with pytest.raises(CalibrationError, match='orientations that tilt the tool differently'):
        weigh_recording(recorded(tmp_path / 'same', file, POSES[:1].repeat(5, axis=0) + 0.2 * (
            np.arange(5) % 2)[:, None] * np.eye(7)[6]), [file])
    six = controller_file(tmp_path)
    six.write_text(six.read_text().replace('j6', 'other').replace('seven.urdf', 'six.urdf'))
    (tmp_path / 'six.urdf').write_text(
        (tmp_path / 'seven.urdf').read_text().replace('"j6"', '"other"'))
    with pytest.raises(RunError, match='positions of the joints .*other, found j0, j1'):
        weigh_recording(tmp_path / 'bag', [six])


def test_arm_without_a_wrist_sensor_has_nothing_to_calibrate(tmp_path):
    file, other = controller_file(tmp_path), tmp_path / 'momentum.yaml'
    other.write_text('/**: {ros__parameters: {wrench_input: momentum, robot: {sensor_frame: ""}, '
                     'sensor: {require_push_test: false}}}')
    with pytest.raises(ConfigError, match='wrench_input: expected raw or filtered: without a'):
        weigh_recording(tmp_path / 'bag', [file, other])


def test_gap_and_motion_are_no_rest():
    time = np.concatenate([np.arange(0.0, 4.0, 0.01), np.arange(10.0, 14.0, 0.01)])
    q = np.zeros((len(time), 2))
    q[(time > 11.0), 1] = 0.5 * (time[time > 11.0] - 11.0).clip(0.0, 0.5)
    rests = find_rests(time, q, RestConfig())
    np.testing.assert_allclose(rests, [(0.5, 3.9), (12.0, 13.9)], atol=0.1)


@pytest.fixture
def arm(tmp_path):
    """Return an arm, and a function that makes what says its samples, every 10 ms."""
    read = read_controller_files([controller_file(tmp_path)])
    robot = RobotModel(read.config().robot, read.urdf_dir)

    def samples(angle_at):
        k = 0

        def sample():
            nonlocal k
            k += 1
            q = POSES[0] + angle_at(0.01 * k)
            rotation = robot.update(q, np.zeros(7)).sensor_pose.rotation_world
            return Sample(0.01 * k, q, TOOL.bias_sensor + weight_reading(
                rotation, TOOL, np.array([0.0, 0.0, -9.81])))
        return sample
    return robot, samples


def test_running_arm_is_weighed_once_it_rests_in_its_own_time(arm):
    robot, samples = arm
    reading = weigh_at_rest(samples(lambda t: min(0.5 * t, 0.6)), robot, RestConfig(), 10.0)
    pose = robot.update(POSES[0] + 0.6, np.zeros(7)).sensor_pose
    np.testing.assert_allclose(reading.rotation_world, pose.rotation_world, atol=1e-12)
    np.testing.assert_allclose(reading.wrench_sensor, TOOL.bias_sensor + weight_reading(
        pose.rotation_world, TOOL, np.array([0.0, 0.0, -9.81])), atol=1e-12)


def test_pose_of_an_arm_that_creeps_is_the_mean_as_its_wrench_is(arm):
    """Taken at the end it would be 0.15 N off."""
    robot, samples = arm
    reading = weigh_at_rest(samples(lambda t: 0.015 * t), robot, RestConfig(), 10.0)
    weight = weight_reading(reading.rotation_world, TOOL, np.array([0.0, 0.0, -9.81]))
    np.testing.assert_allclose(reading.wrench_sensor, TOOL.bias_sensor + weight, atol=0.01)


def test_arm_that_never_rests_is_not_weighed(arm):
    robot, samples = arm
    with pytest.raises(CalibrationError, match=r'expected an arm at rest \(no joint faster than '
                       r'0.02 rad/s\) for 1.5 s within 3 s, found none'):
        weigh_at_rest(samples(lambda t: 0.3 * np.sin(t)), robot, RestConfig(), 3.0)


def test_robot_that_begins_anew_is_not_waited_for(arm):
    robot, samples = arm
    before, after = samples(np.sin), samples(np.sin)
    said = iter([before(), before(), before(), after()])
    with pytest.raises(RunError, match='joint_states: expected stamps that go on, found one '
                       '0.02 s before the last'):
        weigh_at_rest(lambda: next(said), robot, RestConfig(), 3.0)
