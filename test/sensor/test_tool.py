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
POSES = Rotation.random(8, rng=np.random.default_rng(1)).as_matrix()


def readings(rotations, tool=TOOL, noise=0.0, mounting=STRAIGHT, seed=0):
    rng = np.random.default_rng(seed)
    made = []
    for rotation in rotations.as_matrix():
        wrench = (
            predict_weight_reading(rotation, tool, GRAVITY).reshape(2, 3) @ mounting.T
        )
        made.append(
            PoseReading(
                rotation,
                wrench.ravel() + tool.bias_sensor + noise * rng.standard_normal(6),
            )
        )
    return made


def assert_compensates(tool):
    """Check that readings without contact give no wrench in any pose."""
    for rotation in POSES:
        reading = predict_weight_reading(rotation, TOOL, GRAVITY) + BIAS
        assert_allclose(
            contact_wrench(
                reading, Pose(np.ones(3), rotation), np.zeros(3), tool, GRAVITY
            ),
            0.0,
            atol=1e-11,
        )


def test_contact_wrench_is_what_was_put_into_the_reading():
    rng = np.random.default_rng(2)
    pressing = np.array([0.0, 0.0, -12.0])
    weight = TOOL.mass * GRAVITY
    for R in POSES:
        sensor, tip, point = (
            Pose(rng.standard_normal(3), R),
            *rng.standard_normal((2, 3)),
        )
        moment = np.cross(tip - sensor.position_world, pressing) - np.cross(
            R @ np.array(TOOL.com_sensor), weight
        )
        reading = np.concatenate([R.T @ (pressing - weight), R.T @ moment]) + BIAS
        wrench = contact_wrench(reading, sensor, point, TOOL, GRAVITY)
        assert_allclose(
            wrench, [*pressing, *np.cross(tip - point, pressing)], atol=1e-12
        )
        assert_allclose(
            wrench,
            equations.contact_wrench(reading, sensor, point, TOOL, GRAVITY),
            atol=1e-12,
        )


@pytest.mark.parametrize('pose', POSES[:3])
def test_tare_in_any_pose_compensates_in_every_pose(pose):
    reading = predict_weight_reading(pose, TOOL, GRAVITY) + BIAS
    noise = np.random.default_rng(0).standard_normal((50, 6)) * 1e-3
    old = TOOL.model_copy(update={'bias_sensor': (9.0,) * 6})  # does not add up
    bias = compute_tare_bias(reading + noise - noise.mean(axis=0), pose, old, GRAVITY)
    assert_allclose(bias, BIAS, atol=1e-12)
    assert_compensates(TOOL.model_copy(update={'bias_sensor': tuple(bias)}))


@pytest.mark.parametrize(
    ('wrenches', 'message'),
    [
        (np.zeros((24, 6)), 'expected at least 25 readings, got 24'),
        (np.full((30, 6), np.nan), 'expected finite readings'),
        (
            np.outer(0.02 * np.arange(30.0), np.ones(6)),
            r'N m\), got 0.173 N and 0.173 N m',
        ),
    ],
)
def test_tare_refuses_too_few_readings_and_any_unrest(wrenches, message):
    with pytest.raises(CalibrationError, match=f'tare: .*{message}'):
        compute_tare_bias(wrenches, np.eye(3), TOOL, GRAVITY)


def test_identification_without_noise_is_exact():
    result = identify_tool(readings(TILTS), GRAVITY)
    assert result.mass == pytest.approx(TOOL.mass, abs=1e-12)
    assert_allclose(result.com_sensor, TOOL.com_sensor, atol=1e-12)
    assert_allclose(result.bias_sensor, BIAS, atol=1e-12)
    assert max(result.force_residual, result.torque_residual) < 1e-12
    assert result.condition < 10.0
    assert_compensates(result.tool())


def test_identification_errors_are_those_of_repeated_identifications():
    results = [
        identify_tool(readings(TILTS, noise=0.01, seed=k), GRAVITY) for k in range(200)
    ]
    mass = [x.mass for x in results]
    com = np.array([x.com_sensor for x in results])
    assert np.std(mass) == pytest.approx(
        np.mean([x.mass_std for x in results]), rel=0.15
    )
    assert_allclose(
        com.std(axis=0), np.mean([x.com_std for x in results], axis=0), rtol=0.15
    )
    assert np.mean([x.force_residual for x in results]) == pytest.approx(0.01, rel=0.2)


def test_identification_of_an_empty_flange_is_a_mass_of_zero_with_the_bias():
    result = identify_tool(
        readings(TILTS, ToolConfig(bias_sensor=BIAS), noise=1e-3), GRAVITY
    )
    assert abs(result.mass) <= 3.0 * result.mass_std
    assert_array_equal(result.com_sensor, np.zeros(3))
    assert_allclose(result.bias_sensor, BIAS, atol=0.01)


SIMILAR = '^poses: .*tilt the tool differently'


@pytest.mark.parametrize(
    ('poses', 'message'),
    [
        (readings(TILTS[:3]), '^poses: .*expected at least 4, got 3$'),
        (readings(TILTS[[0] * 6]), SIMILAR),
        # Turning about the vertical alone moves no weight.
        (readings(Rotation.from_euler('z', np.arange(6.0)[:, None])), SIMILAR),
        # Tilting about one axis alone leaves the centre of mass along it: seen by the moments.
        (readings(Rotation.from_euler('x', 0.02 * np.arange(6.0)[:, None])), SIMILAR),
        (
            readings(TILTS, mounting=-np.eye(3)),
            'mass: expected at least 0 kg, got -0.5 kg; is ',
        ),
        *(
            (
                readings(TILTS, mounting=Rotation.from_rotvec(turn).as_matrix()),
                'residual|mass',
            )
            for turn in np.pi / 2 * np.vstack([np.eye(3), -np.eye(3)])
        ),
        (
            [
                *readings(TILTS[:2]),
                PoseReading(np.eye(3), np.array([0.0, np.nan, 0.0, 0.0, 0.0, 0.0])),
                *readings(TILTS[3:]),
            ],
            'reading of pose 2: expected finite numbers',
        ),
    ],
)
def test_identification_refuses_poor_poses_and_a_flipped_turned_or_broken_sensor(
    poses, message
):
    with pytest.raises(CalibrationError, match=message):
        identify_tool(poses, GRAVITY)


@pytest.mark.parametrize('mass', [0.0, 0.2])
def test_tool_on_the_way_to_another_is_read_as_a_share_of_both(mass):
    """Also from no tool at all."""
    before = ToolConfig(mass=mass, com_sensor=(0.05, 0.0, 0.02), bias_sensor=(0.5,) * 6)

    def reading(tool):
        weight = predict_weight_reading(POSES[0], tool, GRAVITY)
        return weight + tool.bias_sensor

    for share in (0.0, 0.25, 0.75, 1.0):
        assert_allclose(
            reading(interpolate_tool(before, TOOL, share)),
            (1.0 - share) * reading(before) + share * reading(TOOL),
            atol=1e-12,
        )
