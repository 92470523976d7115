"""The linear loop's stability against Riccati, the paper notes and the loop run in time."""

from dataclasses import replace

from force_loop import H, observer_of
from multicontact_control.errors import ConfigError
from multicontact_control.force.linear_loop import (
    closed_loop_matrix,
    is_stable,
    RealContact,
    stability_boundary,
    steady_gain,
)
import numpy as np
import pytest

K = 6000.0
DELAY_TICKS = 3


def _contact(damping_rate=20.0, **values):
    return RealContact(**{
        'stiffness': K, 'damping_rate': damping_rate, 'input_delay': DELAY_TICKS * H,
        'period': H, **values})


def _stable_ratios(damping_rate, noise_variance, ratios):
    observer = observer_of(damping_rate=damping_rate)
    gain = steady_gain(observer, noise_variance)
    return np.array([is_stable(closed_loop_matrix(
        observer, gain, _contact(damping_rate, stiffness=ratio * K))) for ratio in ratios])


@pytest.mark.parametrize('order', range(4))
@pytest.mark.parametrize('variance', [1e-3, 0.6, 100.0])
def test_steady_gain_is_where_the_observer_settles(order, variance):
    """The Riccati equation and the recursion agree."""
    observer = observer_of(order)
    for _ in range(20000):
        observer.update(0.0, variance)
    settled = observer.P[:, 0] / variance  # K = P C^T / R
    np.testing.assert_allclose(steady_gain(observer, variance), settled, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize('order', range(4))
def test_closed_loop_with_the_right_model_separates(order):
    """Its eigenvalues are those of the feedback and of the filter, (1 - K C) Phi_n."""
    observer = observer_of(order)
    gain = steady_gain(observer, 0.6)
    matrix = closed_loop_matrix(observer, gain, _contact())
    n = observer.Phi_n.shape[0]
    correction = np.eye(n) - np.outer(gain, np.eye(n)[0])
    expected = np.polymul(
        np.poly(observer.loop.closed_loop), np.poly(correction @ observer.Phi_n))
    np.testing.assert_allclose(np.poly(matrix), expected, atol=1e-6)
    assert is_stable(matrix)


@pytest.mark.parametrize(('damping_rate', 'at_rest', 'in_motion'), [
    (20.0, 1.97, 3.16), (60.0, 2.41, 4.44), (100.0, 2.58, 5.44)])
def test_stable_ratios_are_those_of_the_paper_notes(damping_rate, at_rest, in_motion):
    """
    Paper notes 8 tell the last stable ratio of a grid with 34 steps to the decade.

    The boundary itself lies between that and the next point of the grid, 7 % above.
    """
    grid = 10.0 ** (np.arange(-68, 69) / 34.0)
    observer = observer_of(damping_rate=damping_rate)
    for variance, noted in ((0.6, at_rest), (100.0, in_motion)):
        stable = _stable_ratios(damping_rate, variance, grid)
        last = np.flatnonzero(~stable)[0] - 1
        assert grid[last] == pytest.approx(noted, abs=0.005)
        found = stability_boundary(observer, variance, _contact(damping_rate))
        assert grid[last] <= found.upper < grid[last + 1]
        assert found.lower == 0.01


def test_stable_ratios_without_damping_have_both_ends():
    """K_2 = 0: 0.41 to 1.72 on the same grid (paper notes 8)."""
    grid = 10.0 ** (np.arange(-68, 69) / 34.0)
    stable = np.flatnonzero(_stable_ratios(0.0, 0.6, grid))
    assert grid[stable[0]] == pytest.approx(0.41, abs=0.005)
    assert grid[stable[-1]] == pytest.approx(1.72, abs=0.005)
    found = stability_boundary(observer_of(damping_rate=0.0), 0.6, _contact(0.0))
    assert grid[stable[0] - 1] < found.lower <= grid[stable[0]]
    assert grid[stable[-1]] <= found.upper < grid[stable[-1] + 1]


def _growth(observer, variance, contact):
    """
    Run the loop in time and return how its force grows from one half of the run to the other.

    The contact is integrated by Runge-Kutta in quarters of a period, and the observer is the one
    that the controller runs: nothing here is shared with the matrix.
    """
    k_s, c, m = contact.stiffness, contact.contact_damping, contact.effective_mass
    rate = contact.damping_rate if contact.damping == 'plant' else 0.0

    def derivative(s, acceleration):
        return np.array([s[1], acceleration - rate * s[1] - (k_s * s[0] + c * s[1]) / m])

    for _ in range(5000):  # settle the gain first
        observer.update(0.0, variance)
    observer.x_est[:] = 0.0
    observer.command(0.0)
    s = np.array([1.0 / k_s, 0.0])
    forces, commands = [], []
    steps, dt = 4, H / 4
    waiting = round(contact.input_delay / dt)

    def acting(step):
        index = (step - waiting) // steps
        return commands[index] if index >= 0 else 0.0

    for k in range(4000):
        force = (k_s * s[0] + c * s[1]
                 + contact.carried_mass * derivative(s, acting(steps * k - 1))[1])
        forces.append(force)
        observer.update(force, variance)
        command = observer.command(0.0) + observer.x_est[0] / m
        if contact.damping == 'commanded':
            command -= contact.damping_rate * s[1]
        commands.append(command)
        for step in range(steps * k, steps * (k + 1)):
            u = acting(step)
            k1 = derivative(s, u)
            k2 = derivative(s + 0.5 * dt * k1, u)
            k3 = derivative(s + 0.5 * dt * k2, u)
            k4 = derivative(s + dt * k3, u)
            s = s + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    forces = np.abs(forces)
    return forces[2000:].max() / forces[1000:2000].max()


@pytest.mark.parametrize('values', [
    {}, {'damping': 'commanded'}, {'contact_damping': 30.0}, {'effective_mass': 20.0},
    {'carried_mass': 0.2}, {'input_delay': 2.5 * H, 'carried_mass': 0.2},
    {'input_delay': 0.5 * H, 'carried_mass': 0.2},
    {'damping': 'commanded', 'contact_damping': 30.0, 'effective_mass': 20.0,
     'carried_mass': 0.2}])
@pytest.mark.parametrize(('damping_rate', 'variance'), [(20.0, 0.6), (60.0, 100.0)])
def test_boundary_is_where_the_loop_in_time_begins_to_grow(damping_rate, variance, values):
    """Three percent inside it dies away, three percent outside it grows."""
    contact = _contact(damping_rate, **values)
    upper = stability_boundary(
        observer_of(damping_rate=damping_rate), variance, contact).upper
    assert 1.0 < upper < 100.0
    for ratio, grows in ((0.97 * upper, False), (1.03 * upper, True)):
        growth = _growth(observer_of(damping_rate=damping_rate), variance,
                         replace(contact, stiffness=ratio * K))
        assert (growth > 1.0) == grows


def test_boundary_depends_on_where_the_damping_acts():
    """Delayed damping helps less with little of it (paper notes 13)."""
    observer = observer_of()
    plant, commanded = (stability_boundary(
        observer, 0.6, _contact(damping=damping)).upper for damping in ('plant', 'commanded'))
    assert commanded < 0.9 * plant


def test_boundary_shrinks_with_a_delay_that_the_model_does_not_have():
    """Each tick of actuator delay beyond T_d costs stiffness."""
    observer = observer_of()
    uppers = [stability_boundary(observer, 0.6, _contact(input_delay=ticks * H)).upper
              for ticks in range(2, 5)]
    assert uppers[0] > uppers[1] > uppers[2]


def test_boundary_of_a_loop_that_is_never_stable_is_not_a_number():
    """Far too much delay leaves nothing around a ratio of 1."""
    found = stability_boundary(observer_of(), 0.6, _contact(input_delay=20 * H))
    assert np.isnan(found.lower) and np.isnan(found.upper)


def test_boundary_ends_with_its_search():
    """No further than asked for."""
    found = stability_boundary(observer_of(), 0.6, _contact(), lowest=0.5, highest=1.2)
    assert (found.lower, found.upper) == (0.5, 1.2)


@pytest.mark.parametrize('variance', [0.0, -1.0, float('nan'), float('inf')])
def test_steady_gain_refuses_a_variance_out_of_range(variance):
    """The message names it."""
    with pytest.raises(ConfigError, match='^noise_variance: expected a positive number'):
        steady_gain(observer_of(), variance)
