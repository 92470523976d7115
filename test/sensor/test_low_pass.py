"""The low-pass and the delay it adds to the loop's model."""

from arms import controller_config
from multicontact_control.config import SensorFrontEndConfig
from multicontact_control.control.controller import Controller, Measurement
from multicontact_control.control.reference import CommandedReference
from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir
from multicontact_control.sensor.front_end import SensorFrontEnd
from multicontact_control.sensor.low_pass import LowPass
import numpy as np
import pytest
from scipy.signal import butter, group_delay, lfilter

RATE = 500.0


def front_end(order, cutoff):
    return SensorFrontEndConfig(filter_order=order, filter_cutoff=cutoff)


@pytest.mark.parametrize('order', [1, 2])
def test_low_pass_is_scipys_butterworth(order):
    signal = np.random.default_rng(0).standard_normal((200, 6))
    signal[0] = 0.0
    low_pass = LowPass(front_end(order, 40.0), RATE)
    b, a = butter(order, 40.0, fs=RATE)
    np.testing.assert_allclose(
        [low_pass.update(x) for x in signal], lfilter(b, a, signal, axis=0), atol=1e-12)


@pytest.mark.parametrize('order', [0, 1, 2])
def test_low_pass_starts_settled_and_survives_a_missing_number(order):
    low_pass = LowPass(front_end(order, 40.0), RATE)
    wrench = np.arange(1.0, 7.0)
    for _ in range(20):
        np.testing.assert_allclose(low_pass.update(wrench), wrench, rtol=1e-12)
    assert np.isnan(low_pass.update(np.full(6, np.nan))).all()
    np.testing.assert_allclose(low_pass.update(wrench), wrench, rtol=1e-12)
    low_pass.reset()
    np.testing.assert_allclose(low_pass.update(-wrench), -wrench, rtol=1e-12)


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize('cutoff', [15.0, 62.5, 125.0, 240.0])
def test_filter_delay_is_the_group_delay_at_rest_and_that_of_a_ramp(order, cutoff):
    config = front_end(order, cutoff)
    delay = config.filter_delay(RATE)
    # scipy cannot divide where a zero of the filter lies; 0 Hz is far from it.
    _, samples = group_delay(butter(order, cutoff, fs=RATE), w=[1e-3], fs=RATE)
    assert delay == pytest.approx(samples[0] / RATE, rel=1e-4)
    low_pass = LowPass(config, RATE)
    ramp = [low_pass.update(np.full(6, k / RATE))[0] for k in range(1000)]
    assert 999 / RATE - ramp[-1] == pytest.approx(delay, rel=1e-9)


def test_delay_of_the_low_pass_is_in_the_controllers_model():
    """T_d of 6 ms and 3 periods of low-pass: as many delay states as 12 ms."""
    sensor = {'filter_order': 1, 'filter_cutoff': RATE / np.pi * np.arctan(1 / 6)}
    config = controller_config(sensor=sensor)
    assert config.loop_delay == pytest.approx(0.006 + 3 / RATE)
    observers = []
    for changes in ({'sensor': sensor}, {'force': {'input_delay': 0.012}}):
        controller = Controller.from_config(
            controller_config(**changes), CommandedReference(('table', 'board')), config_dir())
        home = np.array([1.847, 0.871, 2.937, 0.0, -0.666, 1.847])
        controller.step(Measurement(0.0, home, np.zeros(6), np.zeros(6)), np.full(2, 0.6))
        observers.append(controller._observers)
    assert observers[0]['states'].tolist() == [2 + 6 + 1] * 2
    np.testing.assert_allclose(observers[0]['feedback'], observers[1]['feedback'], rtol=1e-6)


@pytest.mark.parametrize(('sensor', 'message'), [
    ({'filter_order': 2, 'filter_cutoff': 5.0},
     r'force.input_delay and the delay of sensor.filter_cutoff: expected at most 10 periods '
     r'\(0.02 s\), found 0.006 s \+ 0.045 s'),
    ({'filter_order': 1, 'filter_cutoff': 250.0},
     'sensor.filter_cutoff: expected below the Nyquist frequency 250 Hz, found 250 Hz')])
def test_low_pass_that_does_not_fit_the_loop_is_refused(sensor, message):
    with pytest.raises(ConfigError, match=message):
        controller_config(sensor=sensor)
    assert controller_config(sensor={**sensor, 'filter_order': 0}).loop_delay == 0.006


def test_low_pass_beyond_nyquist_of_its_own_rate_is_refused():
    with pytest.raises(ConfigError, match='sensor.filter_cutoff: expected below'):
        LowPass(front_end(1, 100.0), 150.0)


def test_front_end_watches_the_raw_reading_and_hands_on_the_filtered_one():
    config = SensorFrontEndConfig(
        filter_order=1, filter_cutoff=10.0, full_scale=(10.0,) * 6, frozen_ticks=3)
    chain = SensorFrontEnd(config, RATE)
    chain.update(np.zeros(6))
    jump = chain.update(np.full(6, 10.0))
    assert jump.health.saturated.all()
    assert np.all(jump.wrench_sensor < 5.0)
    chain.update(np.full(6, 10.0))
    assert chain.update(np.full(6, 10.0)).health.frozen
    chain.reset()
    np.testing.assert_allclose(chain.update(np.full(6, 1.0)).wrench_sensor, 1.0)
    assert not SensorFrontEnd(SensorFrontEndConfig(), RATE).update(np.ones(6)).health.fault
