"""From the sensor's reading to the contact wrench: weight, axes, lever, bias, sign."""

import equations
from multicontact_control.config import ToolConfig
from multicontact_control.contact.wrench import contact_wrench
from multicontact_control.dynamics.rotations import Pose
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

GRAVITY = np.array([0.0, 0.0, -9.81])


def test_contact_wrench_is_what_was_put_into_the_reading():
    """Robot on environment, normal into the surface: alpha > 0 (the one sign convention)."""
    tool = ToolConfig(mass=0.5, com_sensor=(0.01, -0.02, 0.08),
                      bias_sensor=(1.0, -2.0, 3.0, 0.1, -0.2, 0.05))
    rng = np.random.default_rng(2)
    pressing, weight = np.array([0.0, 0.0, -12.0]), tool.mass * GRAVITY
    for R in Rotation.random(10, rng=rng).as_matrix():
        sensor, tip, point = Pose(rng.standard_normal(3), R), *rng.standard_normal((2, 3))
        moment = np.cross(tip - sensor.position_world, pressing) - np.cross(
            R @ np.array(tool.com_sensor), weight)
        reading = np.concatenate([R.T @ (pressing - weight), R.T @ moment]) + tool.bias_sensor
        found = contact_wrench(reading, sensor, point, tool, GRAVITY)
        np.testing.assert_allclose(found[:3], pressing, atol=1e-12)
        np.testing.assert_allclose(found[3:], np.cross(tip - point, pressing), atol=1e-12)
        assert np.array([0.0, 0.0, -1.0]) @ found[:3] == pytest.approx(12.0)
        np.testing.assert_allclose(
            found, equations.contact_wrench(reading, sensor, point, tool, GRAVITY), atol=1e-12)
