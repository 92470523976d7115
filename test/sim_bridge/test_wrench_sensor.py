from multicontact_control.errors import ConfigError
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.signal import butter
from sim_bridge.config import SensorConfig
from sim_bridge.wrench_sensor import (
    butterworth_low_pass,
    converter_step,
    low_pass_stages,
    WrenchSensor,
)

PERIOD = 2.5e-4
IDEAL = {'noise': False, 'saturate': False, 'quantise': False, 'low_pass': False}


def make_sensor(**changes):
    config = SensorConfig(**{**IDEAL, **changes})
    return WrenchSensor(config, PERIOD, np.random.default_rng(0))


def read_wrenches(sensor, wrenches):
    """Return the readings of a sensor, shape (n, 6)."""
    readings = []
    for wrench in wrenches:
        sensor.read_wrenches(np.asarray([wrench], dtype=float))
        readings.append(sensor.reading.copy())
    return np.array(readings)


def test_reading_is_rounded_to_the_steps_of_the_converter(rng):
    steps = converter_step(SensorConfig())
    assert_allclose(steps[[0, 2, 3]], [200 / 16384, 400 / 16384, 10 / 16384])
    wrenches = rng.uniform(-1, 1, (200, 6))
    raw = read_wrenches(make_sensor(quantise=True), wrenches)
    assert_allclose(raw / steps, np.round(raw / steps), atol=1e-9)
    error = np.abs(raw - wrenches)
    assert (error <= 0.5 * steps + 1e-15).all()


def test_reading_is_turned_as_mounted_and_biased():
    turned = (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    mounted = make_sensor(mounting=turned, bias=(0.5, 0, 0, 0, 0, 0))
    raw = read_wrenches(mounted, [np.arange(1.0, 7.0)])
    assert_array_equal(raw[0], [-1.5, 1.0, 3.0, -5.0, 4.0, 6.0])


def test_reading_is_saturated_at_the_range():
    ranges = np.array([100.0, 100.0, 200.0, 5.0, 5.0, 5.0])
    raw = read_wrenches(make_sensor(saturate=True), [np.full(6, 1e3), np.full(6, -1e3)])
    assert_array_equal(raw, [ranges, -ranges])


def test_sensor_noise_has_the_asked_deviation():
    raw = read_wrenches(make_sensor(noise=True), np.zeros((20000, 6)))
    deviations = [0.047] * 3 + [0.004] * 3
    assert_allclose(np.std(raw, axis=0), deviations, rtol=0.03)
    assert_allclose(np.mean(raw, axis=0), 0.0, atol=0.0015)
    assert_allclose(np.corrcoef(raw.T), np.eye(6), rtol=0.0, atol=0.03)
    autocorrelation = np.mean(raw[1:, 0] * raw[:-1, 0])
    assert abs(autocorrelation) < 0.03 * 0.047**2


def test_coefficients_of_a_low_pass_are_scipys(rng):
    for rate in (500.0, 1000.0, 4000.0, *rng.uniform(100.0, 1e4, 20)):
        for cutoff in (31.25, *rng.uniform(1.0, 0.49 * rate, 20)):
            expected = butter(2, cutoff, fs=rate)
            assert_array_equal(butterworth_low_pass(cutoff, rate), expected)


def test_cutoff_at_the_nyquist_frequency_is_refused():
    with pytest.raises(ConfigError, match='^sensor.low_pass_cutoff'):
        low_pass_stages(500.0, 1000.0)
