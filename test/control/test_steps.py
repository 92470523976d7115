"""Steps of a commanded motion: walked within the limits, where a stream passes untouched."""

from multicontact_control.config import LimitsConfig
from multicontact_control.control.tasks import CommandedTask, MotionReading, quintic
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

PERIOD = 0.002
LIMITS = LimitsConfig(operational_speed=0.4, operational_acceleration=4.0)
NORMALS = np.array([[0.0, 0.0, -1.0]])
START = Pose(np.array([0.1, 0.5, 0.6]), np.eye(3))
UPRIGHT, FREE = np.array([0.0, 0.0, 0.0, 1.0]), np.empty((0, 3))


@pytest.fixture
def source():
    made = CommandedTask(('table',), limits=LIMITS)
    made.start(START, NORMALS)
    made.task(0.0)
    return made


def walk(source, start, ticks):
    """Return positions, rotation vectors, twists and accelerations, tick by tick."""
    tasks = [source.task(start + PERIOD * (tick + 1)) for tick in range(ticks)]
    return (np.array([task.pose_des.position_world for task in tasks]),
            Rotation.from_matrix([task.pose_des.rotation_world for task in tasks]).as_rotvec(),
            np.array([task.twist_des for task in tasks]),
            np.array([task.acceleration_des for task in tasks]))


def test_step_is_walked_within_a_share_of_the_limits(source):
    goal, turn = START.position_world + [0.1, -0.05, 0.02], np.array([0.0, 0.3, 0.4])
    source.set_motion(MotionReading(
        goal, Rotation.from_rotvec(turn).as_quat(), np.zeros(6), np.zeros(6)), FREE)
    position, rotation, twist, acceleration = walk(source, 0.0, 2000)
    np.testing.assert_allclose(position[-1], goal, atol=1e-12)
    np.testing.assert_allclose(rotation[-1], turn, atol=1e-9)
    assert not twist[-1].any() and not acceleration[-1].any()
    assert np.linalg.norm(twist[:, :3], axis=1).max() <= 0.4 * 0.4 * 1.001
    assert np.linalg.norm(acceleration[:, :3], axis=1).max() <= 0.4 * 4.0 * 1.001
    assert np.linalg.norm(twist[:, 3:], axis=1).max() <= 0.4 * LIMITS.operational_turn * 1.001
    way = np.linalg.norm(position - START.position_world, axis=1)
    assert (np.diff(way) > -1e-5).all() and way.max() < np.linalg.norm(
        goal - START.position_world) * 1.001, 'it goes beyond'
    np.testing.assert_allclose(  # its twist is that of its pose
        np.diff(position, axis=0)[50:300] / PERIOD, twist[51:301, :3], atol=0.005)


@pytest.mark.parametrize('rate', [500, 100])
def test_stream_of_set_points_passes_bit_by_bit(source, rate):
    h = 1.0 / rate
    for tick in range(rate):
        s, ds, dds = quintic(tick * h, 1.0)
        motion = MotionReading(
            START.position_world + [0.15 * s, 0.0, 0.0], UPRIGHT,
            np.array([0.15 * ds, 0, 0, 0, 0, 0]), np.array([0.15 * dds, 0, 0, 0, 0, 0]))
        source.set_motion(motion, FREE)
        task = source.task(tick * h)
        np.testing.assert_array_equal(task.pose_des.position_world, motion.position_world)
        np.testing.assert_array_equal(task.twist_des, motion.twist_world)
        np.testing.assert_array_equal(task.acceleration_des, motion.acceleration_world)


def test_contact_that_is_commanded_on_the_way_stays_beside_its_surface(source):
    source.set_motion(MotionReading(
        START.position_world + [0.1, 0.0, -0.1], UPRIGHT, np.zeros(6), np.zeros(6)), FREE)
    position = walk(source, 0.0, 150)[0]
    height = position[-1, 2]
    assert START.position_world[2] - 0.1 < height < START.position_world[2] - 0.02
    source.set_forces({'table': 5.0})
    position, _, twist, _ = walk(source, 0.3, 1500)
    np.testing.assert_allclose(position[:, 2], height, atol=1e-12)
    assert not twist[:, 2].any()
    np.testing.assert_allclose(position[-1, :2], START.position_world[:2] + [0.1, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize(('robot', 'plant'), [
    ('puma', 'puma'), ('puma', 'rigid'), ('panda', 'rigid'), ('panda', 'flexible'),
    ('ur5', 'rigid')])
@pytest.mark.parametrize(('way', 'duration'), [
    ([0.1, 0.0, 0.0], 0.0), ([0.0, 0.0, 0.1], 0.0), ([0.1, 0.0, 0.0], 0.375)])
def test_arm_goes_where_it_is_told_within_its_limits_and_without_a_hold(
        robot, plant, way, duration):
    """In one message, and in the shortest time that `move` accepts."""
    loop = ClosedLoop(resolve('quick', robot=robot, plant=plant), commanded=True)
    config, reactions, speeds = loop.setup.controller, set(), []
    for _ in range(100):
        loop.advance()
    start = loop.control.output.pose_des
    place, turn = start.position_world.copy(), start.quaternion_xyzw.copy()
    step, zero = np.array(way), np.zeros(3)
    for tick in range(1000):
        s, ds, dds = quintic(tick * config.period, duration) if duration else (1.0, 0.0, 0.0)
        if tick * config.period <= duration:
            loop.control.set_motion(MotionReading(
                place + s * step, turn, np.append(ds * step, zero), np.append(dds * step, zero)))
        output = loop.advance()
        reactions.add(loop.control.status.reaction)
        speeds.append(np.linalg.norm(output.controls['frame']['twist'][0, :3]))
    assert reactions == {'none'}
    assert max(speeds) < 1.05 * config.limits.operational_speed
    np.testing.assert_allclose(output.pose.position_world, place + step, atol=5e-4)
    loop.close()
