"""Tare: zero where it was done, and everywhere else too."""

from multicontact_control.config import ToolConfig
from multicontact_control.contact.wrench import contact_wrench
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CalibrationError
from multicontact_control.sensor.tool import tare_bias, weight_reading
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

GRAVITY = np.array([0.0, 0.0, -9.81])
TOOL = ToolConfig(mass=0.5, com_sensor=(0.01, -0.02, 0.08))
BIAS = np.array([1.0, -2.0, 3.0, 0.1, -0.2, 0.05])
POSES = Rotation.random(8, rng=np.random.default_rng(1)).as_matrix()


@pytest.mark.parametrize('pose', POSES)
def test_tare_in_any_pose_compensates_in_every_pose(pose):
    reading = weight_reading(pose, TOOL, GRAVITY) + BIAS
    noise = np.random.default_rng(0).standard_normal((50, 6)) * 1e-3
    old = TOOL.model_copy(update={'bias_sensor': (9.0,) * 6})  # does not add up
    bias = tare_bias(reading + noise - noise.mean(axis=0), pose, old, GRAVITY)
    np.testing.assert_allclose(bias, BIAS, atol=1e-12)
    tool = TOOL.model_copy(update={'bias_sensor': tuple(bias)})
    for other in POSES:
        wrench = contact_wrench(weight_reading(other, TOOL, GRAVITY) + BIAS,
                                Pose(np.ones(3), other), np.zeros(3), tool, GRAVITY)
        np.testing.assert_allclose(wrench, 0.0, atol=1e-12)


@pytest.mark.parametrize(('wrenches', 'message'), [
    (np.zeros((24, 6)), 'tare: expected at least 25 readings, found 24'),
    (np.full((30, 6), np.nan), 'tare: expected finite readings'),
    (np.outer(np.arange(30.0), np.ones(6)), 'tare: expected readings at rest'),
    (np.outer(0.02 * np.arange(30.0), np.ones(6)), r'N m\), found 0.173 N and 0.173 N m')])
def test_tare_refuses_what_is_no_rest(wrenches, message):
    with pytest.raises(CalibrationError, match=message):
        tare_bias(wrenches, np.eye(3), TOOL, GRAVITY)
