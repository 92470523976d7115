import numpy as np
import pytest
from sim_bridge.actuator_delay import ActuatorDelay

INITIAL = np.array([-7.0, -7.0])


def torque(tick):
    return np.array([float(tick), -1.0])


@pytest.mark.parametrize('ticks', [0, 1, 5])
def test_command_for_sample_k_acts_from_k_plus_ticks(ticks):
    delay = ActuatorDelay(ticks, INITIAL)
    for tick in range(12):
        if ticks == 0:
            delay.command(tick, torque(tick))
        expected = INITIAL if tick < ticks else torque(tick - ticks)
        np.testing.assert_array_equal(delay.torque_for(tick), expected)
        if ticks > 0:
            delay.command(tick, torque(tick))
    assert delay.misses == 0


def test_missing_command_holds_the_last_one_and_is_counted():
    delay = ActuatorDelay(1, INITIAL)
    delay.torque_for(0)
    delay.command(0, torque(0))
    np.testing.assert_array_equal(delay.torque_for(1), torque(0))
    assert delay.missing(2)
    np.testing.assert_array_equal(delay.torque_for(2), torque(0))
    delay.command(2, torque(2))
    assert not delay.missing(3)
    np.testing.assert_array_equal(delay.torque_for(3), torque(2))
    assert delay.misses == 1


def test_late_command_never_replaces_a_newer_one():
    delay = ActuatorDelay(0, INITIAL)
    delay.command(3, torque(3))
    delay.torque_for(3)
    delay.command(1, torque(1))
    np.testing.assert_array_equal(delay.torque_for(4), torque(3))
