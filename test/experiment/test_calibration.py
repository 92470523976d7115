"""Weighing the tool and pushing it, on the simulated arm with noise."""

from multicontact_control.config import ControllerConfig, merge, read_parameters, validate
from multicontact_control.contact.wrench import contact_wrench
from multicontact_control.errors import CalibrationError
from multicontact_control.experiment.calibration import (
    calibrate,
    calibration_config,
    sensor_setup,
    write_tool,
)
from multicontact_control.experiment.position_controlled_plant import ServoedPlant
from multicontact_control.experiment.push_trial import fault_mounting, push_setup, run_push_test
from multicontact_control.paths import config_dir
from multicontact_control.sensor.push_test import PushTestConfig
import numpy as np
import pytest

SHORT = {'move_time': 0.8, 'settle_time': 0.3, 'average_time': 0.3}


@pytest.mark.parametrize(('plant', 'seed'), [('rigid', 1), ('puma', 2)])
def test_calibration_finds_tool_and_bias_of_the_noisy_sensor(tmp_path, plant, seed):
    """Mass within 2 %, centre of mass within 3 mm, bias within 0.1 N; the file is laid over."""
    setup = sensor_setup(plant, seed)
    result = calibrate(setup, calibration_config().model_copy(update=SHORT))
    mass, com, bias = result.errors
    assert setup.plant.sensor.noise and any(result.truth.bias_sensor)
    assert (mass < 0.02, com < 3e-3, bias < 0.1) == (True, True, True), result
    assert result.good
    np.testing.assert_allclose(
        result.found.bias_sensor[3:], result.truth.bias_sensor[3:], atol=5e-3)
    assert result.found.condition < 5.0
    controller = validate(ControllerConfig, merge(
        read_parameters(config_dir() / 'controller.yaml'),
        read_parameters(write_tool(tmp_path, result))))
    assert controller.tool == result.found.tool()


def test_calibration_poses_are_free_and_weigh_nothing_with_the_right_tool():
    """The configured tool is the plant's: compensated readings vanish, up to the noise."""
    setup = sensor_setup('rigid', 0, sensor={'noise': False, 'bias': [1.0] * 6})
    tool = setup.controller.tool.model_copy(update={'bias_sensor': (1.0,) * 6})
    arm = ServoedPlant(setup)
    for pose in calibration_config().poses:
        arm.move(np.array(pose), 0.8)
        sample, state = arm.hold(0.4)[-1]
        assert not sample.contact_force.any()
        np.testing.assert_allclose(sample.q, pose, atol=0.03)
        wrench = contact_wrench(
            sample.wrench, state.sensor_pose, state.pose.position_world, tool,
            np.array(setup.controller.robot.gravity_world))
        np.testing.assert_allclose(wrench, 0.0, atol=0.03)
    arm.close()


def test_calibration_of_a_flipped_sensor_is_refused():
    setup = sensor_setup('rigid', 0, sensor={'mounting': [-1, 0, 0, 0, -1, 0, 0, 0, -1]})
    with pytest.raises(CalibrationError, match='sign'):
        calibrate(setup, calibration_config().model_copy(update=SHORT))


@pytest.mark.parametrize(('plant', 'fault', 'seed', 'found'), [
    ('rigid', 'none', 0, 'passed'), ('puma', 'none', 1, 'passed'),
    ('rigid', 'sign', 0, 'sign flipped'), ('puma', 'sign', 3, 'sign flipped'),
    ('rigid', 'scale', 1, 'scale 0.5'),
    *(('rigid', 'rotate', seed, f"rotated by {degrees} deg about the sensor's {axis}")
      for seed, (degrees, axis) in enumerate(
          (degrees, axis) for degrees in (90, -90) for axis in 'xyz')),
    ('puma', 'rotate', 5, "rotated by -90 deg about the sensor's z")])
def test_push_test_names_the_fault_of_the_mounting(plant, fault, seed, found):
    """Tared first, so that nothing is wrong at rest."""
    config = PushTestConfig(settle_time=0.2, hold_time=0.2)
    setup = push_setup(plant, seed, config, fault_mounting(fault, seed))
    result = run_push_test(setup, config, lambda instruction: None)
    assert found in result.message
    assert result.passed is (fault == 'none')
