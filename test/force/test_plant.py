"""The delayed plant against scipy's continuous one, and its pole placement."""

from force_loop import design_force_loop
from multicontact_control.errors import ConfigError
from multicontact_control.force.plant import ackermann, delayed_plant
import numpy as np
import pytest
from scipy.signal import lsim, place_poles

H = 0.002
K = 6000.0


@pytest.mark.parametrize('k_2', [0.0, 20.0, 100.0])
@pytest.mark.parametrize('delay', [0.0, 0.0005, 0.002, 0.0061])
def test_delayed_plant_agrees_with_the_continuous_one(k_2, delay):
    """alpha'' + K_2 alpha' = k u(t - T_d) (eq. 32), for whole and broken periods."""
    inputs, fine = np.random.default_rng(2).standard_normal(12), 20  # steps of 0.1 ms
    plant = delayed_plant(K, k_2, delay, H)
    assert len(plant.Gamma) == 2 + int(np.ceil(delay / H - 1e-9))
    states = [np.zeros(plant.Phi.shape[0])]
    for value in inputs:
        states.append(plant.Phi @ states[-1] + plant.Gamma * value)
    late = np.concatenate([np.zeros(round(delay * fine / H)), np.repeat(inputs, fine), [0.0]])
    count = len(inputs) * fine + 1
    system = ([[0.0, 1.0], [0.0, -k_2]], [[0.0], [K]], np.eye(2), np.zeros((2, 1)))
    _, expected, _ = lsim(system, late[:count], H / fine * np.arange(count), interp=False)
    np.testing.assert_allclose(
        np.array(states)[:, :2], expected[::fine], rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(('arguments', 'field'), [
    ((0.0, 20.0, 0.006, H), 'stiffness'), ((K, -1.0, 0.006, H), 'damping_rate'),
    ((K, 20.0, 0.0201, H), 'input_delay'), ((float('nan'), 20.0, 0.006, H), 'stiffness')])
def test_delayed_plant_refuses_values_out_of_range(arguments, field):
    with pytest.raises(ConfigError, match=f'^{field}: expected'):
        delayed_plant(*arguments)


@pytest.mark.parametrize('delay', [0.0, 0.002, 0.006, 0.0125])
def test_place_poles_places_the_designed_poles(delay):
    """exp(-h/tau) twice, 0 for the delays; r = L_1 f_des settles at f_des (paper notes 4)."""
    loop = design_force_loop(input_delay=delay)
    pole, n = np.exp(-H / 0.02), len(loop.L)
    np.testing.assert_allclose(
        np.poly(loop.closed_loop), np.poly([pole, pole] + [0.0] * (n - 2)), atol=1e-9)
    settled = np.linalg.solve(np.eye(n) - loop.closed_loop, loop.plant.Gamma * loop.L[0] * 10.0)
    assert settled[0] == pytest.approx(10.0, rel=1e-9)


def test_ackermann_agrees_with_scipy_for_distinct_poles():
    plant = delayed_plant(K, 20.0, 0.006, H)
    poles = [0.9, 0.85, 0.1, 0.05, -0.1]
    reference = place_poles(plant.Phi, plant.Gamma[:, None], poles).gain_matrix[0]
    np.testing.assert_allclose(
        ackermann(plant.Phi, plant.Gamma, poles), reference, rtol=1e-6)
