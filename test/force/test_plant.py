"""The delayed plant against integration of the continuous one, and its pole placement."""

from force_loop import design_force_loop
from multicontact_control.errors import ConfigError
from multicontact_control.force.plant import ackermann, delayed_plant
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import place_poles

H = 0.002
K = 6000.0


def _integrate(inputs, k_2, delay):
    """Integrate alpha'' + K_2 alpha' = k u(t - T_d) piecewise with scipy."""
    times = np.arange(len(inputs) + 1) * H

    def u(t):
        index = int(np.floor((t - delay) / H + 1e-9))
        return inputs[index] if 0 <= index < len(inputs) else 0.0

    edges = np.unique(np.round(np.concatenate([times, times[:-1] + delay % H]), 12))
    edges = edges[edges <= times[-1] + 1e-12]
    state = np.zeros(2)
    results = {0.0: state}
    for a, b in zip(edges[:-1], edges[1:]):
        force = u(0.5 * (a + b))
        solution = solve_ivp(
            lambda t, x, force: [x[1], K * force - k_2 * x[1]], (a, b), state, args=(force,),
            rtol=1e-11, atol=1e-12)
        state = solution.y[:, -1]
        results[float(b)] = state
    return np.array([results[min(results, key=lambda s: abs(s - t))] for t in times])


@pytest.mark.parametrize('k_2', [0.0, 20.0, 100.0])
@pytest.mark.parametrize('delay', [0.0, 0.0005, 0.002, 0.0061])
def test_delayed_plant_agrees_with_the_continuous_one(k_2, delay):
    """Zero-order hold and delay of eq. 32, for whole and broken periods."""
    inputs = np.random.default_rng(2).standard_normal(12)
    plant = delayed_plant(K, k_2, delay, H)
    assert len(plant.Gamma) == 2 + int(np.ceil(delay / H - 1e-9))
    x = np.zeros(plant.Phi.shape[0])
    states = [x]
    for value in inputs:
        x = plant.Phi @ x + plant.Gamma * value
        states.append(x)
    expected = _integrate(inputs, k_2, delay)
    np.testing.assert_allclose(np.array(states)[:, :2], expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(('arguments', 'field'), [
    ((0.0, 20.0, 0.006, H), 'stiffness'), ((K, -1.0, 0.006, H), 'damping_rate'),
    ((K, 20.0, 0.0201, H), 'input_delay'), ((K, 20.0, -0.001, H), 'input_delay'),
    ((K, 20.0, 0.006, 0.0), 'period'), ((float('nan'), 20.0, 0.006, H), 'stiffness')])
def test_delayed_plant_refuses_values_out_of_range(arguments, field):
    with pytest.raises(ConfigError, match=f'^{field}: expected'):
        delayed_plant(*arguments)


@pytest.mark.parametrize('delay', [0.0, 0.002, 0.006, 0.0125])
def test_place_poles_places_the_designed_poles(delay):
    """The characteristic polynomial is the wanted one: exp(-h/tau) twice, 0 for the delays."""
    loop = design_force_loop(input_delay=delay)
    pole = np.exp(-H / 0.02)
    wanted = np.poly([pole, pole] + [0.0] * (len(loop.L) - 2))
    np.testing.assert_allclose(np.poly(loop.closed_loop), wanted, atol=1e-9)


def test_ackermann_agrees_with_scipy_for_distinct_poles():
    plant = delayed_plant(K, 20.0, 0.006, H)
    poles = [0.9, 0.85, 0.1, 0.05, -0.1]
    reference = place_poles(plant.Phi, plant.Gamma[:, None], poles).gain_matrix[0]
    np.testing.assert_allclose(
        ackermann(plant.Phi, plant.Gamma, poles), reference, rtol=1e-6)


def test_force_loop_has_unit_gain_from_desired_to_real_force():
    """With r = L_1 f_des the force settles at f_des (paper notes 4)."""
    loop = design_force_loop()
    x = np.zeros(5)
    for _ in range(500):
        x = loop.closed_loop @ x + loop.plant.Gamma * (loop.L[0] * 10.0)
    assert x[0] == pytest.approx(10.0, rel=1e-9)
