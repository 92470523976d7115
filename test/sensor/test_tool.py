"""
The tool on the wrist sensor: its weight and bias, taken off, tared and identified.

Sign convention: robot on environment, normal into the surface, so that pressing is alpha > 0.
"""

import equations
from multicontact_control.config import ToolConfig
from multicontact_control.contact.wrench import contact_wrench, interpolate_tool
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CalibrationError
from multicontact_control.sensor.tool import (
    compute_tare_bias,
    identify_tool,
    PoseReading,
    predict_weight_reading,
)
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.spatial.transform import Rotation

GRAVITY = np.array([0.0, 0.0, -9.81])
STRAIGHT = np.eye(3)
BIAS = (1.0, -2.0, 3.0, 0.1, -0.2, 0.05)
TOOL = ToolConfig(mass=0.5, com_sensor=(0.01, -0.02, 0.08), bias_sensor=BIAS)
TILTS = Rotation.from_euler(
    'XZ', [[0, 0], [0.8, 0], [-0.8, 0], [0.8, 1.5], [-0.8, 1.5]]
)
POSES = Rotation.random(8, np.random.default_rng(1)).as_matrix()


def read_in_poses(rotations, tool=TOOL, noise=0.0, mounting=STRAIGHT, seed=0):
    """Return what a sensor reads of a tool at rest, one turned inside its housing."""
    rng = np.random.default_rng(seed)
    readings = []
    for rotation in rotations.as_matrix():
        weight = predict_weight_reading(rotation, tool, GRAVITY).reshape(2, 3)
        error = noise * rng.standard_normal(6)
        wrench = (weight @ mounting.T).ravel() + tool.bias_sensor + error
        readings.append(PoseReading(rotation, wrench))
    return readings


def assert_compensates(tool):
    """Check that readings without contact give no wrench in any pose."""
    point = np.zeros(3)
    for rotation in POSES:
        reading = predict_weight_reading(rotation, TOOL, GRAVITY) + BIAS
        sensor = Pose(np.ones(3), rotation)
        wrench = contact_wrench(reading, sensor, point, tool, GRAVITY)
        assert_allclose(wrench, 0.0, atol=1e-11)


def test_contact_wrench_is_what_was_put_into_the_reading():
    rng = np.random.default_rng(2)
    pressing = np.array([0.0, 0.0, -12.0])
    weight = TOOL.mass * GRAVITY
    for R in POSES:
        place, tip, point = rng.standard_normal((3, 3))
        sensor = Pose(place, R)
        moment = np.cross(tip - place, pressing)
        moment_of_weight = np.cross(R @ np.array(TOOL.com_sensor), weight)
        force_read = R.T @ (pressing - weight)
        torque_read = R.T @ (moment - moment_of_weight)
        reading = np.append(force_read, torque_read) + BIAS
        wrench = contact_wrench(reading, sensor, point, TOOL, GRAVITY)
        expected = np.append(pressing, np.cross(tip - point, pressing))
        assert_allclose(wrench, expected, atol=1e-12)
        literal = equations.contact_wrench(reading, sensor, point, TOOL, GRAVITY)
        assert_allclose(wrench, literal, atol=1e-12)


@pytest.mark.parametrize('pose', POSES[:3])
def test_tare_in_any_pose_compensates_in_every_pose(pose):
    reading = predict_weight_reading(pose, TOOL, GRAVITY) + BIAS
    noise = np.random.default_rng(0).standard_normal((50, 6)) * 1e-3
    old = TOOL.model_copy(update={'bias_sensor': (9.0,) * 6})  # does not add up
    bias = compute_tare_bias(reading + noise - noise.mean(axis=0), pose, old, GRAVITY)
    assert_allclose(bias, BIAS, atol=1e-12)
    assert_compensates(TOOL.model_copy(update={'bias_sensor': tuple(bias)}))


RISING = np.outer(0.02 * np.arange(30.0), np.ones(6))


@pytest.mark.parametrize(
    ('wrenches', 'message'),
    [
        (np.zeros((24, 6)), 'expected at least 25 readings, got 24'),
        (np.full((30, 6), np.nan), 'expected finite readings'),
        (RISING, r'N m\), got 0.173 N and 0.173 N m'),
    ],
)
def test_tare_refuses_too_few_readings_and_any_unrest(wrenches, message):
    with pytest.raises(CalibrationError, match=f'tare: .*{message}'):
        compute_tare_bias(wrenches, np.eye(3), TOOL, GRAVITY)


def test_identification_without_noise_is_exact():
    result = identify_tool(read_in_poses(TILTS), GRAVITY)
    assert result.mass == pytest.approx(TOOL.mass, abs=1e-12)
    assert_allclose(result.com_sensor, TOOL.com_sensor, atol=1e-12)
    assert_allclose(result.bias_sensor, BIAS, atol=1e-12)
    assert max(result.force_residual, result.torque_residual) < 1e-12
    assert result.condition < 10.0
    assert_compensates(result.tool())


def test_identification_errors_are_those_of_repeated_identifications():
    results = []
    for seed in range(200):
        readings = read_in_poses(TILTS, noise=0.01, seed=seed)
        results.append(identify_tool(readings, GRAVITY))
    mass = [result.mass for result in results]
    mass_std = np.mean([result.mass_std for result in results])
    assert np.std(mass) == pytest.approx(mass_std, rel=0.15)
    com = np.array([result.com_sensor for result in results])
    com_std = np.mean([result.com_std for result in results], axis=0)
    assert_allclose(com.std(axis=0), com_std, rtol=0.15)
    residuals = [result.force_residual for result in results]
    assert np.mean(residuals) == pytest.approx(0.01, rel=0.2)


def test_identification_of_an_empty_flange_is_a_mass_of_zero_with_the_bias():
    nothing = ToolConfig(bias_sensor=BIAS)
    result = identify_tool(read_in_poses(TILTS, nothing, noise=1e-3), GRAVITY)
    assert abs(result.mass) <= 3.0 * result.mass_std
    assert_array_equal(result.com_sensor, np.zeros(3))
    assert_allclose(result.bias_sensor, BIAS, atol=0.01)


NUMBERS = np.arange(6.0)[:, None]


@pytest.mark.parametrize(
    'rotations',
    [
        TILTS[[0] * 6],
        # Turning about the vertical alone moves no weight.
        Rotation.from_euler('z', NUMBERS),
        # Tilting about one axis alone leaves the centre of mass along it: seen by the moments.
        Rotation.from_euler('x', 0.02 * NUMBERS),
    ],
)
def test_identification_refuses_poses_that_are_too_similar(rotations):
    with pytest.raises(CalibrationError, match='^poses: .*tilt the tool differently'):
        identify_tool(read_in_poses(rotations), GRAVITY)


def test_identification_refuses_fewer_than_four_poses():
    with pytest.raises(CalibrationError, match='^poses: .*expected at least 4, got 3$'):
        identify_tool(read_in_poses(TILTS[:3]), GRAVITY)


def test_identification_refuses_a_flipped_sensor():
    flipped = read_in_poses(TILTS, mounting=-np.eye(3))
    message = 'mass: expected at least 0 kg, got -0.5 kg; is '
    with pytest.raises(CalibrationError, match=message):
        identify_tool(flipped, GRAVITY)


@pytest.mark.parametrize('axis', np.vstack([np.eye(3), -np.eye(3)]))
def test_identification_refuses_a_sensor_that_is_turned_by_a_quarter(axis):
    mounting = Rotation.from_rotvec(np.pi / 2 * axis).as_matrix()
    with pytest.raises(CalibrationError, match='residual|mass'):
        identify_tool(read_in_poses(TILTS, mounting=mounting), GRAVITY)


def test_identification_refuses_a_reading_that_is_not_finite():
    readings = read_in_poses(TILTS)
    readings[2].wrench_sensor[1] = np.nan
    message = 'reading of pose 2: expected finite numbers'
    with pytest.raises(CalibrationError, match=message):
        identify_tool(readings, GRAVITY)


@pytest.mark.parametrize('mass', [0.0, 0.2])
def test_tool_on_the_way_to_another_is_read_as_a_share_of_both(mass):
    """Also from no tool at all."""
    before = ToolConfig(mass=mass, com_sensor=(0.05, 0.0, 0.02), bias_sensor=(0.5,) * 6)

    def reading(tool):
        weight = predict_weight_reading(POSES[0], tool, GRAVITY)
        return weight + tool.bias_sensor

    for share in (0.0, 0.25, 0.75, 1.0):
        between = reading(interpolate_tool(before, TOOL, share))
        expected = (1.0 - share) * reading(before) + share * reading(TOOL)
        assert_allclose(between, expected, atol=1e-12)
