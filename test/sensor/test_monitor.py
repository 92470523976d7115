"""Saturated and frozen readings, and how often a live sensor looks frozen."""

from multicontact_control.config import SensorFrontEndConfig, validate
from multicontact_control.errors import ConfigError, ShapeError
from multicontact_control.sensor.monitor import repeat_probability, SensorMonitor
import numpy as np
import pytest

FULL_SCALE = (100.0, 100.0, 200.0, 5.0, 5.0, 5.0)
STD = np.repeat([0.047, 0.004], 3)
STEPS = np.array(FULL_SCALE) * 2 / 2 ** 14


@pytest.mark.parametrize('axis', range(6))
@pytest.mark.parametrize('sign', [-1.0, 1.0])
def test_monitor_names_the_saturated_axis(axis, sign):
    monitor = SensorMonitor(SensorFrontEndConfig(full_scale=FULL_SCALE))
    wrench = np.zeros(6)
    wrench[axis] = sign * FULL_SCALE[axis]
    health = monitor.update(wrench)
    np.testing.assert_array_equal(np.flatnonzero(health.saturated), [axis])
    assert health.fault == 'saturated'
    assert not monitor.update(0.98 * wrench).fault


def test_monitor_without_a_full_scale_finds_no_saturation():
    assert not SensorMonitor(SensorFrontEndConfig()).update(np.full(6, 1e9)).fault


def test_monitor_finds_a_frozen_sensor_in_time_and_its_recovery():
    monitor = SensorMonitor(SensorFrontEndConfig(frozen_ticks=5))
    found = [monitor.update(np.ones(6)).frozen for _ in range(8)]
    assert found == [False] * 4 + [True] * 4
    almost = np.ones(6)
    almost[5] += 1e-9
    assert not monitor.update(almost).fault
    monitor.update(almost)
    monitor.reset()
    assert [monitor.update(almost).frozen for _ in range(5)] == [False] * 4 + [True]


def test_monitor_takes_a_missing_number_for_a_reading_like_any_other():
    monitor = SensorMonitor(SensorFrontEndConfig(frozen_ticks=3, full_scale=FULL_SCALE))
    found = [monitor.update(np.full(6, np.nan)) for _ in range(3)]
    assert [health.frozen for health in found] == [False, False, True]
    assert not any(health.saturated.any() for health in found)


def test_monitor_is_off_by_default():
    monitor = SensorMonitor(SensorFrontEndConfig())
    assert not any(monitor.update(np.ones(6)).fault for _ in range(100))


def test_repeat_probability_is_that_of_simulated_readings():
    rng = np.random.default_rng(0)
    for std, step in ((0.047, STEPS[0]), (0.01, 0.05), (1.0, 0.3)):
        # The bound is at the worst true value; the middle of a step is it if the step is wide.
        read = np.rint(std * rng.standard_normal(400_000) / step)
        measured = np.mean(read[1:] == read[:-1])
        assert repeat_probability([std], [step]) == pytest.approx(measured, rel=0.03)


def test_live_jr3_does_not_look_frozen():
    """Five equal readings in a row: less than once in the age of the universe at 500 Hz."""
    assert repeat_probability(STD, STEPS) == pytest.approx(6.3e-8, rel=0.1)
    assert repeat_probability(STD, STEPS, samples=5) < 1e-25


def test_sensor_too_quiet_for_its_steps_always_repeats():
    assert repeat_probability(STD * 1e-3, STEPS, samples=5) == pytest.approx(1.0)


@pytest.mark.parametrize(('values', 'message'), [
    ({'full_scale': [1.0]}, 'sensor.full_scale: expected 6 values or none, found 1'),
    ({'full_scale': [0.0] * 6}, 'sensor.full_scale: expected values above 0'),
    ({'frozen_ticks': 1}, 'sensor.frozen_ticks: expected 0 or at least 2, found 1')])
def test_monitor_configuration_is_checked(values, message):
    with pytest.raises(ConfigError, match=message):
        validate(SensorFrontEndConfig, values)


def test_monitor_refuses_a_reading_of_another_size():
    with pytest.raises(ShapeError, match='wrench_sensor'):
        SensorMonitor(SensorFrontEndConfig()).update(np.zeros(3))
