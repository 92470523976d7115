"""Payload and bias from a few poses: exact without noise, accepted only when well posed."""

from multicontact_control.config import ToolConfig
from multicontact_control.contact.wrench import contact_wrench
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CalibrationError
from multicontact_control.sensor.tool import identify_tool, PoseReading, weight_reading
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

GRAVITY = np.array([0.0, 0.0, -9.81])
BIAS = (1.0, -2.0, 3.0, 0.1, -0.2, 0.05)
TOOL = ToolConfig(mass=0.5, com_sensor=(0.01, -0.02, 0.08), bias_sensor=BIAS)
TILTS = Rotation.from_euler('XZ', [[0, 0], [0.8, 0], [-0.8, 0], [0.8, 1.5], [-0.8, 1.5]])


def readings(rotations, tool=TOOL, noise=0.0, mounting=None, seed=0):
    rng = np.random.default_rng(seed)
    mounting = np.eye(3) if mounting is None else mounting
    made = []
    for rotation in rotations.as_matrix():
        wrench = weight_reading(rotation, tool, GRAVITY).reshape(2, 3) @ np.transpose(mounting)
        made.append(PoseReading(
            rotation, wrench.ravel() + tool.bias_sensor + noise * rng.standard_normal(6)))
    return made


def test_identification_without_noise_is_exact():
    found = identify_tool(readings(TILTS), GRAVITY)
    assert found.mass == pytest.approx(0.5, abs=1e-12)
    np.testing.assert_allclose(found.com_sensor, TOOL.com_sensor, atol=1e-12)
    np.testing.assert_allclose(found.bias_sensor, BIAS, atol=1e-12)
    assert max(found.force_residual, found.torque_residual) < 1e-12
    assert found.condition < 10.0


def test_identified_tool_compensates_every_pose():
    rng = np.random.default_rng(3)
    tool = identify_tool(readings(TILTS), GRAVITY).tool()
    for reading in readings(Rotation.random(10, rng=rng)):
        wrench = contact_wrench(
            reading.wrench_sensor, Pose(np.zeros(3), reading.rotation_world), np.ones(3), tool,
            GRAVITY)
        np.testing.assert_allclose(wrench, 0.0, atol=1e-11)


def test_standard_errors_are_those_of_repeated_identifications():
    found = [identify_tool(readings(TILTS, noise=0.01, seed=seed), GRAVITY) for seed in range(200)]
    mass, com = [x.mass for x in found], np.array([x.com_sensor for x in found])
    assert np.std(mass) == pytest.approx(np.mean([x.mass_std for x in found]), rel=0.15)
    np.testing.assert_allclose(
        com.std(axis=0), np.mean([x.com_std for x in found], axis=0), rtol=0.15)
    assert np.mean([x.force_residual for x in found]) == pytest.approx(0.01, rel=0.2)


def test_nothing_on_the_flange_is_a_mass_of_zero_with_the_bias():
    found = identify_tool(
        readings(TILTS, ToolConfig(bias_sensor=BIAS), noise=1e-3), GRAVITY)
    assert abs(found.mass) <= 3.0 * found.mass_std
    np.testing.assert_array_equal(found.com_sensor, np.zeros(3))
    np.testing.assert_allclose(found.bias_sensor, BIAS, atol=0.01)


@pytest.mark.parametrize(('poses', 'message'), [
    (TILTS[:3], r'^poses: expected at least 4, found 3$'),
    (TILTS[[0] * 6], r'^poses: expected orientations that tilt the tool differently .* found '),
    # Turning about the vertical alone moves no weight.
    (Rotation.from_euler('z', np.arange(6.0)[:, None]), 'tilt the tool differently'),
    # Tilting about one axis alone leaves the centre of mass along it: seen by the moments.
    (Rotation.from_euler('x', 0.02 * np.arange(6.0)[:, None]), 'tilt the tool differently')])
def test_too_few_or_too_similar_poses_are_refused_in_one_line(poses, message):
    with pytest.raises(CalibrationError, match=message) as caught:
        identify_tool(readings(poses), GRAVITY)
    assert '\n' not in str(caught.value)


def test_flipped_and_turned_sensors_are_refused():
    with pytest.raises(CalibrationError, match='mass: expected at least 0 kg, found -0.5 kg; is '):
        identify_tool(readings(TILTS, mounting=-np.eye(3)), GRAVITY)
    for axis in 'xyz':
        for sign in (1, -1):
            turned = Rotation.from_euler(axis, sign * np.pi / 2).as_matrix()
            with pytest.raises(CalibrationError, match='residual|mass'):
                identify_tool(readings(TILTS, mounting=turned), GRAVITY)


def test_readings_that_are_not_numbers_are_refused():
    bad = readings(TILTS)
    bad[2].wrench_sensor[1] = np.nan
    with pytest.raises(CalibrationError, match='reading of pose 2: expected finite numbers'):
        identify_tool(bad, GRAVITY)
