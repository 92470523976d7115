"""The active observer against its equations, and what it promises."""

import equations
from force_loop import ActiveObserver, design_force_loop
from multicontact_control.force.observer import (
    command,
    continue_at,
    design_observer,
    make_observers,
    observe,
    rescale,
)
from multicontact_control.records import CONTACT
import numpy as np
import pytest


@pytest.fixture
def loop():
    return design_force_loop()


def _simulate(loop, observer, disturbance):
    """Run an observer on the plant it models; return the last true force."""
    x = np.zeros(5)
    for each in disturbance:
        observer.update(x[0], 0.6)
        x = loop.plant.Phi @ x + loop.plant.Gamma * (observer.command(10.0) + each)
    return x[0]


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


def test_active_state_finds_a_constant_disturbance(loop):
    """No error at rest with it (P04 sec. 4); order 0 is plain pole placement."""
    observer = ActiveObserver(loop)
    assert _simulate(loop, observer, np.full(1500, 0.05)) == pytest.approx(10.0, abs=1e-6)
    assert observer.x_est[-1] == pytest.approx(0.05, rel=1e-4)
    assert abs(_simulate(loop, ActiveObserver(loop, order=0), np.full(1500, 0.05)) - 10.0) > 0.5


def test_second_order_active_state_tracks_a_ramp(loop):
    """p_k = 2 p_k-1 - p_k-2 follows a ramp without error (paper notes, active state)."""
    errors = [abs(_simulate(loop, ActiveObserver(loop, order=order), 1e-4 * np.arange(3000))
                  - 10.0) for order in (1, 2)]
    assert errors[1] < 0.05 * errors[0]


def test_continue_from_predicts_with_the_input_that_acts(loop):
    faster = design_force_loop(time_constant=0.01)
    old, unchanged = ActiveObserver(loop), ActiveObserver(loop)
    forces = np.random.default_rng(1).normal(5.0, 1.0, 20)
    for observer in (old, unchanged):
        for force in forces:
            observer.update(force, 0.6)
            observer.command(10.0)
    new = ActiveObserver(faster)
    new.continue_from(old)
    for observer in (new, unchanged):
        observer.update(7.0, 0.6)
    np.testing.assert_allclose(new.x_est, unchanged.x_est, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(new.P, unchanged.P, rtol=1e-12)


def test_observer_without_a_new_wrench_predicts_only(loop):
    """As with a measurement of infinite variance, every third time."""
    options = {'order': 1, 'process_noise': 2e-3, 'initial_covariance': 5e-3}
    observers = make_observers([design_observer(loop, **options)])
    literal = equations.Observer(loop.plant.Phi, loop.plant.Gamma, loop.L, **options)
    contact, random = np.zeros(1, dtype=CONTACT)[0], np.random.default_rng(6)
    contact['alpha_meas'], contact['noise_variance'] = 4.0, 0.6
    literal.reset(4.0)
    for k in range(30):
        measured = k % 3 < 2
        literal.update(contact['alpha_meas'], 0.6 if measured else np.inf)
        observe(observers[0], contact, measured, 0.0)
        u = command(observers[0], 10.0)
        np.testing.assert_allclose(
            observers['x_est'][0, :len(literal.x_est)], literal.x_est, rtol=1e-9, atol=1e-12)
        assert u == pytest.approx(literal.command(10.0), rel=1e-8)
        contact['alpha_meas'] = 8.0 + random.normal()


@pytest.mark.parametrize('order', [0, 1, 3])
def test_rescaled_observer_is_the_one_designed_for_the_other_stiffness(order):
    def designed(stiffness):
        return make_observers([design_observer(design_force_loop(stiffness), order=order)])

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
