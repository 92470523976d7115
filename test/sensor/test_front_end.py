"""What the front end finds, its low-pass, and the delay that this adds to the loop's model."""

from arms import controller_config
from multicontact_control.config import SensorFrontEndConfig
from multicontact_control.control.controller import Controller, Measurement
from multicontact_control.control.reference import CommandedReference
from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir
from multicontact_control.sensor.front_end import SensorFrontEnd
import numpy as np
import pytest
from scipy.signal import butter, group_delay, lfilter

RATE = 500.0
FULL_SCALE = (100.0, 100.0, 200.0, 5.0, 5.0, 5.0)


def front_end(order, cutoff):
    return SensorFrontEndConfig(filter_order=order, filter_cutoff=cutoff)


def monitor(**config):
    """Return a front end, and what gives its fault and its filtered reading."""
    chain = SensorFrontEnd(SensorFrontEndConfig(**config), RATE)
    return chain, lambda wrench: (chain.take(np.array(wrench, dtype=float)), chain.filtered.copy())


def low_pass(config):
    chain, take = monitor(**config.model_dump())
    return chain, lambda wrench: take(wrench)[1]


@pytest.mark.parametrize('order', [1, 2])
def test_low_pass_is_scipys_butterworth(order):
    signal = np.random.default_rng(0).standard_normal((200, 6))
    signal[0] = 0.0
    passed = low_pass(front_end(order, 40.0))[1]
    b, a = butter(order, 40.0, fs=RATE)
    np.testing.assert_allclose(
        [passed(x) for x in signal], lfilter(b, a, signal, axis=0), atol=1e-12)


@pytest.mark.parametrize('order', [1, 2])
def test_low_pass_starts_settled_and_survives_a_missing_number(order):
    chain, passed = low_pass(front_end(order, 40.0))
    wrench = np.arange(1.0, 7.0)
    for _ in range(20):
        np.testing.assert_allclose(passed(wrench), wrench, rtol=1e-12)
    assert np.isnan(passed(np.full(6, np.nan))).all()
    np.testing.assert_allclose(passed(wrench), wrench, rtol=1e-12)
    chain.reset()
    np.testing.assert_allclose(passed(-wrench), -wrench, rtol=1e-12)


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize('cutoff', [15.0, 62.5, 125.0, 240.0])
def test_filter_delay_is_the_group_delay_at_rest_and_that_of_a_ramp(order, cutoff):
    config = front_end(order, cutoff)
    delay = config.filter_delay(RATE)
    # scipy cannot divide where a zero of the filter lies; 0 Hz is far from it.
    _, samples = group_delay(butter(order, cutoff, fs=RATE), w=[1e-3], fs=RATE)
    assert delay == pytest.approx(samples[0] / RATE, rel=1e-4)
    _, passed = low_pass(config)
    ramp = [passed(np.full(6, k / RATE))[0] for k in range(1000)]
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
        observers.append(controller.observers)
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


def test_front_end_watches_the_raw_reading_and_hands_on_the_filtered_one():
    chain, take = monitor(
        filter_order=1, filter_cutoff=10.0, full_scale=(10.0,) * 6, frozen_ticks=3)
    take(np.zeros(6))
    fault, wrench = take(np.full(6, 10.0))
    assert fault == 'saturated' and np.all(wrench < 5.0)
    take(np.full(6, 10.0))
    assert take(np.full(6, 10.0))[0] == 'frozen'
    chain.reset()
    np.testing.assert_allclose(take(np.ones(6))[1], 1.0)


@pytest.mark.parametrize('axis', range(6))
@pytest.mark.parametrize('sign', [-1.0, 1.0])
def test_a_saturated_axis_is_found_where_the_full_scale_is_known(axis, sign):
    wrench = sign * np.array(FULL_SCALE) * (np.arange(6) == axis)
    take = monitor(full_scale=FULL_SCALE)[1]
    assert take(wrench)[0] == 'saturated'
    assert not take(0.98 * wrench)[0]
    assert not monitor()[1](1e9 * wrench)[0]


@pytest.mark.parametrize('value', [1.0, np.nan])
def test_frozen_sensor_is_found_in_time_and_its_recovery(value):
    chain, take = monitor(frozen_ticks=5)
    assert [take([value] * 6)[0] for _ in range(8)] == [''] * 4 + ['frozen'] * 4
    almost = np.ones(6) + 1e-9 * (np.arange(6) == 5)
    assert not take(almost)[0]
    chain.reset()
    assert [take(almost)[0] for _ in range(5)] == [''] * 4 + ['frozen']
    take = monitor()[1]  # off by default
    assert not any(take([value] * 6)[0] for _ in range(20))
