"""Drives without a controller hold where they are."""

import numpy as np
import pinocchio as pin
import pytest
from sim_bridge.drives import PositionHold


def after_a_push(plant, left_to):
    """Push the arm off, then leave it for a second; return how far and how fast it then is."""
    hold = PositionHold(plant.model)
    torque = plant.initial_torque + np.array([3.0, -3.0, 2.0, 0.0, 0.0, 0.0])
    for _ in range(50):
        sample = plant.step(torque)
    begin = sample.q
    assert np.abs(sample.qd).max() > 0.02
    for _ in range(500):
        sample = plant.step(
            torque if left_to == 'torque' else hold.torque(sample.q, sample.qd))
    return np.abs(sample.q - begin).max(), np.abs(sample.qd).max()


@pytest.mark.parametrize('preset', ['rigid', 'puma'])
def test_hold_stops_a_moving_arm_where_the_last_torque_does_not(make_plant, preset):
    distance, speed = after_a_push(make_plant(preset), 'hold')
    assert distance < 0.01
    assert speed < 0.005
    assert after_a_push(make_plant(preset), 'torque')[0] > 10.0 * distance


def test_hold_begins_anew_after_it_has_ended(make_plant):
    plant = make_plant('rigid')
    hold = PositionHold(plant.model)
    home, still = plant.reset().q, np.zeros(6)
    np.testing.assert_allclose(hold.torque(home, still), plant.initial_torque, atol=1e-9)
    off = home + [0.0, 0.0, 0.0, 0.0, 0.0, 0.01]
    pulled = hold.torque(off, still)
    hold.end()
    assert not hold.holding
    assert hold.torque(off, still)[5] - pulled[5] > 0.1
    np.testing.assert_allclose(hold.torque(off, still), pin.rnea(
        plant.model, plant.model.createData(), off, still, still), atol=1e-9)
