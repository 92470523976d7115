"""From the sensor's reading to the contact wrench: weight, axes, lever, sign."""

import equations
from multicontact_control.config import ToolConfig
from multicontact_control.control.wrench import contact_wrench
from multicontact_control.dynamics.pose import Pose
from multicontact_control.errors import ShapeError
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

GRAVITY = np.array([0.0, 0.0, -9.81])
TOOL = ToolConfig(mass=0.5, com_sensor=(0.01, -0.02, 0.08))


def _reading(sensor, force_world, point_world, tool=TOOL):
    """Return what a sensor reads at rest: what the arm does to the tool, in the sensor's frame."""
    com = sensor.position_world + sensor.rotation_world @ np.array(tool.com_sensor)
    weight = tool.mass * GRAVITY
    force = force_world - weight
    moment = (np.cross(point_world - sensor.position_world, force_world)
              - np.cross(com - sensor.position_world, weight))
    R = sensor.rotation_world
    return np.concatenate([R.T @ force, R.T @ moment])


@pytest.fixture
def sensor():
    return Pose(np.array([0.1, 0.5, 0.6]),
                Rotation.from_rotvec([2.0, 0.5, -1.0]).as_matrix())


def test_free_tool_gives_no_contact_wrench_in_any_posture():
    """Only the weight is in the reading, and it is subtracted."""
    rng = np.random.default_rng(0)
    for rotation in Rotation.random(10, rng=rng).as_matrix():
        sensor = Pose(rng.standard_normal(3), rotation)
        wrench = contact_wrench(
            _reading(sensor, np.zeros(3), np.zeros(3)), sensor, rng.standard_normal(3), TOOL,
            GRAVITY)
        np.testing.assert_allclose(wrench, 0.0, atol=1e-12)


def test_contact_force_is_moved_to_the_operational_point(sensor):
    """A force at a tip has its moment about the operational point."""
    force, tip, point = np.array([3.0, 10.0, -15.0]), np.array([0.2, 0.7, 0.4]), np.zeros(3)
    wrench = contact_wrench(_reading(sensor, force, tip), sensor, point, TOOL, GRAVITY)
    np.testing.assert_allclose(wrench[:3], force, atol=1e-12)
    np.testing.assert_allclose(wrench[3:], np.cross(tip - point, force), atol=1e-12)


def test_pressing_down_on_a_table_is_positive_along_the_normal(sensor):
    """Robot on environment, normal into the surface: alpha > 0 (the one sign convention)."""
    wrench = contact_wrench(_reading(sensor, np.array([0.0, 0.0, -12.0]), np.zeros(3)), sensor,
                            np.zeros(3), TOOL, GRAVITY)
    assert np.array([0.0, 0.0, -1.0]) @ wrench[:3] == pytest.approx(12.0)


def test_contact_wrench_refuses_a_reading_of_another_length(sensor):
    """The message names the array."""
    with pytest.raises(ShapeError, match=r'wrench_sensor: expected shape \(6,\)'):
        contact_wrench(np.zeros(3), sensor, np.zeros(3), TOOL, GRAVITY)


def test_bias_of_the_sensor_is_taken_off(sensor):
    """A biased sensor with its bias known is as good as one without."""
    bias = (1.0, -2.0, 3.0, 0.1, -0.2, 0.05)
    reading = _reading(sensor, np.array([3.0, 10.0, -15.0]), np.ones(3))
    biased = TOOL.model_copy(update={'bias_sensor': bias})
    np.testing.assert_allclose(
        contact_wrench(reading + bias, sensor, np.zeros(3), biased, GRAVITY),
        contact_wrench(reading, sensor, np.zeros(3), TOOL, GRAVITY), atol=1e-12)


def test_contact_wrench_is_the_equation():
    rng = np.random.default_rng(2)
    for rotation in Rotation.random(10, rng=rng).as_matrix():
        sensor, point = Pose(rng.standard_normal(3), rotation), rng.standard_normal(3)
        reading = rng.standard_normal(6)
        np.testing.assert_allclose(
            contact_wrench(reading, sensor, point, TOOL, GRAVITY),
            equations.contact_wrench(reading, sensor, point, TOOL, GRAVITY), atol=1e-12)
