"""The delayed plant and the active observer against their equations (P04 eqs 32-41)."""

from dataclasses import astuple

import equations
from force_loop import ActiveObserver, design_force_loop, H, observer_of
from multicontact_control.errors import ConfigError
from multicontact_control.force.observer import (
    continue_observer_after_pause,
    continue_observers_from,
    correct_prediction,
    design_observer,
    make_observers,
    predict_state,
)
from multicontact_control.force.plant import make_delayed_plant
from multicontact_control.records import MAX_ORDER
from numba import njit
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.signal import lsim

K = 6000.0


@pytest.mark.parametrize('k_2', [0.0, 20.0, 100.0])
@pytest.mark.parametrize('delay', [0.0, 0.0005, 0.002, 0.0061])
def test_delayed_plant_agrees_with_the_continuous_one(k_2, delay):
    """The plant alpha'' + K_2 alpha' = k u(t - T_d) (eq. 32), for whole and broken periods."""
    inputs = np.random.default_rng(2).standard_normal(12)
    fine = 20  # steps of 0.1 ms in a period
    plant = make_delayed_plant(K, k_2, delay, H)
    assert len(plant.Gamma) == 2 + int(np.ceil(delay / H - 1e-9))
    states = [np.zeros(len(plant.Gamma))]
    for value in inputs:
        states.append(plant.Phi @ states[-1] + plant.Gamma * value)
    waiting = np.zeros(round(delay * fine / H))
    times = H / fine * np.arange(len(inputs) * fine + 1)
    late = np.concatenate([waiting, np.repeat(inputs, fine), [0.0]])[: len(times)]
    A = [[0.0, 1.0], [0.0, -k_2]]
    system = (A, [[0.0], [K]], np.eye(2), np.zeros((2, 1)))
    _, expected, _ = lsim(system, late, times, interp=False)
    found = np.array(states)[:, :2]
    assert_allclose(found, expected[::fine], rtol=1e-8, atol=1e-9)


def test_delayed_plant_refuses_more_than_ten_periods_of_delay():
    with pytest.raises(ConfigError, match='^input_delay: expected'):
        make_delayed_plant(K, 20.0, 0.0201, H)


@pytest.mark.parametrize('delay', [0.0, 0.002, 0.006, 0.0125])
def test_place_poles_places_the_designed_poles(delay):
    """exp(-h/tau) twice, 0 for the delays; r = L_1 f_des settles at f_des."""
    loop = design_force_loop(input_delay=delay)
    n = len(loop.L)
    poles = np.zeros(n)
    poles[:2] = np.exp(-H / 0.02)
    assert_allclose(np.poly(loop.closed_loop), np.poly(poles), atol=1e-9)
    command = loop.plant.Gamma * loop.L[0] * 10.0
    settled = np.linalg.solve(np.eye(n) - loop.closed_loop, command)
    assert settled[0] == pytest.approx(10.0, rel=1e-9)


@pytest.fixture
def loop():
    return design_force_loop()


def force_error(loop, order, disturbance):
    """Return the last error of the force where an observer holds 10 N, and its estimates."""
    observer = ActiveObserver(loop, order=order)
    x = np.zeros(5)
    for each in disturbance:
        observer.update(x[0], 0.6)
        x = loop.plant.Phi @ x + loop.plant.Gamma * (observer.command(10.0) + each)
    return abs(x[0] - 10.0), observer.x_est


@pytest.mark.parametrize('every', [1, 3])
@pytest.mark.parametrize('order', [0, 1, 2, 3])
def test_observer_is_equations_34_to_41_in_full_matrices(loop, order, every):
    """With a variance that jumps; a sample without a wrench has an infinite one."""
    options = {'order': order, 'process_noise': 2e-3}
    observer = ActiveObserver(loop, **options)
    random = np.random.default_rng(4)
    plant = loop.plant
    literal = equations.Observer(
        plant.Phi, plant.Gamma, loop.L, initial_covariance=1e-3, **options
    )
    literal.reset(1.0)
    force = 1.0
    for k in range(200):
        noise_variance = 10.0 ** random.uniform(-2, 2)
        measured = every == 1 or k % every > 0
        variance = np.inf
        if measured:
            variance = noise_variance
        observer.update(force, noise_variance, measured)
        literal.update(force, variance)
        assert_allclose(observer.x_est, literal.x_est, rtol=1e-8, atol=1e-10)
        assert_allclose(observer.P, literal.P, rtol=1e-8, atol=1e-10)
        if measured:
            found = np.ravel(astuple(observer.innovation))
            expected = [literal.innovation, literal.prior_variance, variance]
            if k == 0:
                expected = np.zeros(3)
            assert_allclose(found, expected, rtol=1e-8)
        assert observer.command(10.0) == pytest.approx(literal.command(10.0), rel=1e-8)
        force = random.normal(5.0)


@njit
def update_covariance(observers, variances, spaces):
    """Let the covariance of an observer, which no measurement changes, go on."""
    for variance in variances:
        predict_state(observers[0], spaces[0])
        correct_prediction(observers[0], 0.0, variance, spaces[0])


@pytest.mark.parametrize('damping_rate', [0.0, 20.0])
@pytest.mark.parametrize('order', range(MAX_ORDER + 1))
def test_covariance_stays_symmetric_positive_and_right_over_hours(order, damping_rate):
    """R jumps between floor and ceiling: every tick, at random times and every 20 000 ticks."""
    random = np.random.default_rng(11)
    ticks = np.arange(100_000)
    at_random_times = np.cumsum(random.random(len(ticks)) < 0.01)
    jumps = np.concatenate([ticks, at_random_times, ticks // 20_000])
    R = np.where(jumps % 2, 1e6, 1e-3)
    observer = observer_of(order, damping_rate)
    fresh = observer_of(order, damping_rate)
    for each in (observer, fresh):
        each.update(0.0, 0.6)  # begins
    for variances in np.split(R, 300):
        update_covariance(observer.records, variances, observer.space)
        assert_array_equal(observer.P, observer.P.T)
        sizes = np.sqrt(np.diag(observer.P))
        correlation = observer.P / np.outer(sizes, sizes)
        assert np.linalg.eigvalsh(correlation)[0] > 1e-9
    for each in (observer, fresh):
        update_covariance(each.records, np.full(20_000, 0.6), each.space)
    assert_allclose(observer.P, fresh.P, rtol=1e-6, atol=1e-15)


def test_active_state_compensates_a_constant_disturbance_and_a_ramp(loop):
    """p_k = p_k-1 leaves no error at rest, p_k = 2 p_k-1 - p_k-2 none in a ramp (P04 sec. 4)."""
    constant = np.full(1500, 0.05)
    ramp = 1e-4 * np.arange(3000)
    assert force_error(loop, 0, constant)[0] > 0.5
    error, x_est = force_error(loop, 1, constant)
    assert error < 1e-6
    assert x_est[-1] == pytest.approx(0.05, rel=1e-4)
    error_of_first_order, _ = force_error(loop, 1, ramp)
    assert force_error(loop, 2, ramp)[0] < 0.05 * error_of_first_order


def test_continue_from_predicts_with_the_input_that_acts(loop):
    faster = design_force_loop(time_constant=0.01)
    old = ActiveObserver(loop)
    unchanged = ActiveObserver(loop)
    forces = np.random.default_rng(1).normal(5.0, 1.0, 20)
    for observer in (old, unchanged):
        for force in forces:
            observer.update(force, 0.6)
            observer.command(10.0)
    new = ActiveObserver(faster)
    continue_observers_from(new.records, old.records)
    for observer in (new, unchanged):
        observer.update(7.0, 0.6)
    assert_allclose(new.x_est, unchanged.x_est, rtol=1e-9, atol=1e-9)
    assert_allclose(new.P, unchanged.P, rtol=1e-12)


def test_observer_that_continues_knows_its_disturbance_and_others_begin_anew(loop):
    observers = make_observers([design_observer(loop)] * 2)
    observers['running'] = True
    observers['x_est'][:, :6] = [8.0, 3.0, 0.1, 0.2, 0.3, 0.7]
    continue_observer_after_pause(observers[0], True, 5.0)
    continue_observer_after_pause(observers[1], False, 6.0)
    assert observers['running'].tolist() == [True, False]
    assert_array_equal(observers['x_est'][0, :6], [5.0, 0.0, 0.0, 0.0, 0.0, 0.7])
