"""The active observer against scipy's Riccati solver and its own promises."""

import equations
from force_loop import ActiveObserver
from multicontact_control.errors import ConfigError
from multicontact_control.force.observer import (
    active_state_matrix,
    continue_at,
    design_observer,
    make_observers,
    rescale,
)
from multicontact_control.force.plant_model import delayed_plant, design_force_loop
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

H = 0.002


@pytest.fixture
def loop():
    return design_force_loop(
        6000.0, damping_rate=20.0, input_delay=0.006, period=H, time_constant=0.02)


def _simulate(loop, observer, ticks, *, disturbance=None, noise=None, true_stiffness=6000.0,
              command=10.0, variance=0.6):
    """Run an observer on the plant it models, or a stiffer one; return the true forces."""
    plant = delayed_plant(true_stiffness, 20.0, 0.006, H)
    x = np.zeros(5)
    forces = []
    for k in range(ticks):
        measured = x[0] + (noise[k] if noise is not None else 0.0)
        observer.update(measured, variance)
        u = observer.command(command)
        x = plant.Phi @ x + plant.Gamma * (u + (disturbance[k] if disturbance is not None else 0))
        forces.append(x[0])
    return np.array(forces)


@pytest.mark.parametrize('variance', [0.6, 100.0])
def test_gain_converges_to_scipys_riccati_solution(loop, variance):
    """P_1k settles at the DARE's solution (P04 eqs 39-41)."""
    observer = ActiveObserver(loop)
    C = np.zeros((6, 1))
    C[0] = 1.0
    P_1 = solve_discrete_are(observer.Phi_n.T, C, 1e-3 * np.eye(6), np.array([[variance]]))
    reference = P_1[:, 0] / (P_1[0, 0] + variance)
    for _ in range(3000):
        observer.update(0.0, variance)
    predicted = observer.Phi_n @ observer.P @ observer.Phi_n.T + 1e-3 * np.eye(6)
    gain = predicted[:, 0] / (predicted[0, 0] + variance)
    np.testing.assert_allclose(gain, reference, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize('order', [0, 1, 2, 3])
def test_observer_is_equations_34_to_41_in_full_matrices(loop, order):
    """Over 200 samples with a variance that jumps, from a start at rest."""
    options = {'order': order, 'process_noise': 2e-3, 'initial_covariance': 5e-3}
    observer = ActiveObserver(loop, **options)
    literal = equations.Observer(loop.plant.Phi, loop.plant.Gamma, loop.L, **options)
    random = np.random.default_rng(4)
    for each in (observer, literal):
        each.reset(1.0)
    for _ in range(200):
        force, variance, force_des = random.normal(5.0), 10.0 ** random.uniform(-2, 2), 10.0
        for each in (observer, literal):
            each.update(force, variance)
        for name in ('x_est', 'P', 'innovation', 'prior_variance', 'variance_used'):
            np.testing.assert_allclose(
                getattr(observer, name), getattr(literal, name), rtol=1e-8, atol=1e-10)
        assert observer.command(force_des) == pytest.approx(literal.command(force_des), rel=1e-8)


def test_observer_rejects_a_constant_input_disturbance(loop):
    """The active state finds p and takes it out: no error at rest (P04 sec. 4)."""
    observer = ActiveObserver(loop)
    forces = _simulate(loop, observer, 1500, disturbance=np.full(1500, 0.05))
    assert forces[-1] == pytest.approx(10.0, abs=1e-6)
    assert observer.x_est[-1] == pytest.approx(0.05, rel=1e-4)


def test_without_active_state_a_disturbance_leaves_an_error(loop):
    """Order 0 is plain pole placement."""
    observer = ActiveObserver(loop, order=0)
    forces = _simulate(loop, observer, 1500, disturbance=np.full(1500, 0.05))
    assert abs(forces[-1] - 10.0) > 0.5


def test_second_order_active_state_tracks_a_ramp_that_first_order_lags(loop):
    """p_k = 2 p_k-1 - p_k-2 follows a ramp without error (paper notes, active state)."""
    ramp = 1e-4 * np.arange(3000)
    errors = {}
    for order in (1, 2):
        observer = ActiveObserver(loop, order=order)
        errors[order] = abs(_simulate(loop, observer, 3000, disturbance=ramp)[-1] - 10.0)
    assert errors[2] < 0.05 * errors[1]


@pytest.mark.parametrize('order', [1, 2, 3])
def test_active_state_matrix_continues_polynomials(order):
    """Order n continues polynomials of degree n - 1."""
    samples = np.polyval(np.arange(1, order + 1), np.arange(order + 1))
    state = active_state_matrix(order) @ samples[order - 1::-1]
    assert state[0] == pytest.approx(samples[order])
    np.testing.assert_allclose(state[1:], samples[1:order][::-1])


def test_observer_reset_forgets_everything(loop):
    """Two runs from reset are one run."""
    observer = ActiveObserver(loop)
    first = _simulate(loop, observer, 50)
    observer.reset()
    np.testing.assert_array_equal(_simulate(loop, observer, 50), first)


def test_observer_reset_starts_at_the_measured_force(loop):
    """The first sample after a reset makes no jump."""
    observer = ActiveObserver(loop)
    observer.reset(7.0)
    observer.update(7.0, 0.6)
    assert observer.x_est[0] == 7.0
    assert observer.command(7.0) == pytest.approx(0.0, abs=1e-9)


def test_observer_tells_its_innovation_and_what_it_expected_of_it(loop):
    """Report y - C x_1, C P_1 C^T and R of the last update; nothing right after a reset."""
    observer = ActiveObserver(loop)
    observer.reset(2.0)
    observer.update(2.0, 0.6)
    assert (observer.innovation, observer.prior_variance, observer.variance_used) == (0, 0, 0)
    x_pred = (observer.Phi_c @ observer.x_est)[0]
    P_1 = observer.Phi_n @ observer.P @ observer.Phi_n.T + np.diag(observer.Q)
    observer.update(2.5, 0.6)
    assert observer.innovation == pytest.approx(2.5 - x_pred, rel=1e-12)
    assert observer.prior_variance == pytest.approx(P_1[0, 0], rel=1e-12)
    assert observer.variance_used == 0.6


def test_observer_filters_noise_of_the_variance_it_is_told(loop):
    """The estimate is closer to the true force than the measurement is."""
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(4000)
    observer = ActiveObserver(loop)
    x = np.zeros(5)
    error = []
    for k in range(4000):
        observer.update(x[0] + noise[k], 1.0)
        u = observer.command(10.0)
        if k > 500:
            error.append(observer.x_est[0] - x[0])
        x = loop.plant.Phi @ x + loop.plant.Gamma * u
    assert np.std(error) < 0.5


@pytest.mark.parametrize(('options', 'field'), [
    ({'order': 4}, 'active_state_order'), ({'process_noise': 0.0}, 'process_noise'),
    ({'initial_covariance': -1.0}, 'initial_covariance')])
def test_observer_refuses_options_out_of_range(loop, options, field):
    """The message names the field."""
    with pytest.raises(ConfigError, match=f'^{field}: expected'):
        ActiveObserver(loop, **options)


def test_continue_from_predicts_with_the_input_that_acts(loop):
    """In the tick of a change the prediction is that of the old design, whatever the new one."""
    faster = design_force_loop(
        6000.0, damping_rate=20.0, input_delay=0.006, period=H, time_constant=0.01)
    old, unchanged = ActiveObserver(loop), ActiveObserver(loop)
    forces = np.random.default_rng(1).normal(5.0, 1.0, 20)
    for observer in (old, unchanged):
        for force in forces:
            observer.update(force, 0.6)
            observer.command(10.0)
    new = ActiveObserver(faster)
    assert new.continue_from(old)
    for observer in (new, unchanged):
        observer.update(7.0, 0.6)
    np.testing.assert_allclose(new.x_est, unchanged.x_est, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(new.P, unchanged.P, rtol=1e-12)


def test_continue_from_leaves_a_state_of_another_size(loop):
    old, new = ActiveObserver(loop), ActiveObserver(loop, order=2)
    old.update(3.0, 0.6)
    old.x_est[:] = 4.0
    assert not new.continue_from(old)
    assert not new.x_est.any()


@pytest.mark.parametrize('order', [0, 1, 3])
def test_rescaled_observer_is_the_one_designed_for_the_other_stiffness(order):
    def designed(stiffness):
        return make_observers([design_observer(design_force_loop(
            stiffness, damping_rate=20.0, input_delay=0.006, period=H, time_constant=0.02),
            order=order)])

    observers, wanted = designed(6000.0), designed(7800.0)
    rescale(observers, np.array([1.3]))
    for name in ('Phi_c', 'Phi_n', 'Gamma', 'feedback', 'Q'):
        scale = np.abs(wanted[name]).max()
        np.testing.assert_allclose(observers[name], wanted[name], atol=1e-9 * scale)


def test_observer_that_goes_on_knows_its_disturbance_and_the_others_begin_anew(loop):
    observers = make_observers([design_observer(loop)] * 2)
    observers['running'] = True
    observers['x_est'][:, :6] = [8.0, 3.0, 0.1, 0.2, 0.3, 0.7]
    continue_at(observers, np.array([True, False]), np.array([5.0, 6.0]))
    assert observers['running'].tolist() == [True, False]
    np.testing.assert_array_equal(observers['x_est'][0, :6], [5.0, 0.0, 0.0, 0.0, 0.0, 0.7])
