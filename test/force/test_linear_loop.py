"""The linear loop's stability against Riccati, the paper notes and the loop run in time."""

from force_loop import H, observer_of
from multicontact_control.errors import ConfigError, ShapeError
from multicontact_control.force.laws import steady_law
from multicontact_control.force.linear_loop import (
    bisect,
    closed_loop,
    last_stable,
    LinearArmPlant,
    spectral_radius,
    steady_gain,
)
import numpy as np
import pytest

K = 6000.0
DELAY_TICKS = 3


def _plant(
    ratio=1.0, damping_rate=20.0, damping=0.0, mobility=0.0, tool=0.0, delay=DELAY_TICKS * H,
):
    """Return one contact; by itself that of eq. 32."""
    return LinearArmPlant(
        np.array([[mobility]]), np.array([ratio * K]), np.array([damping]), np.array([[tool]]),
        delay, damping_rate)


def _radius(observer, gain, ratio, damping_rate=20.0, commanded=False, **values):
    own, measured = (0.0, damping_rate) if commanded else (damping_rate, 0.0)
    return spectral_radius(
        closed_loop(_plant(ratio, own, **values), steady_law(observer.design, gain), measured, H))


def _boundary(observer, variance, damping_rate=20.0, **values):
    gain = steady_gain(observer, variance)
    return last_stable(
        lambda ratio: _radius(observer, gain, ratio, damping_rate, **values) < 1.0,
        np.geomspace(1.0, 100.0, 95).tolist(), 1e-4)[0]


def _stable_ratios(damping_rate, noise_variance, ratios):
    observer = observer_of(damping_rate=damping_rate)
    gain = steady_gain(observer, noise_variance)
    return np.array([_radius(observer, gain, ratio, damping_rate) < 1.0 for ratio in ratios])


@pytest.mark.parametrize('order', range(4))
@pytest.mark.parametrize('variance', [1e-3, 0.6, 100.0])
def test_steady_gain_is_where_the_observer_settles(order, variance):
    """The Riccati equation and the recursion agree."""
    observer = observer_of(order)
    for _ in range(4000):  # of 1900, in the slowest case, to 1e-7
        observer.update(0.0, variance)
    settled = observer.P[:, 0] / variance  # K = P C^T / R
    np.testing.assert_allclose(steady_gain(observer, variance), settled, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize('order', range(4))
def test_closed_loop_with_the_right_model_separates(order):
    """Its eigenvalues are those of the feedback, of the filter, (1 - K C) Phi_n, and of y."""
    observer = observer_of(order)
    gain = steady_gain(observer, 0.6)
    matrix = closed_loop(_plant(), steady_law(observer.design, gain), 0.0, H)
    n = observer.Phi_n.shape[0]
    correction = np.eye(n) - np.outer(gain, np.eye(n)[0])
    expected = np.polymul(
        np.poly(observer.loop.closed_loop), np.poly(correction @ observer.Phi_n))
    np.testing.assert_allclose(np.poly(matrix), np.append(expected, 0.0), atol=1e-6)
    assert spectral_radius(matrix) < 1.0


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
        assert stable[:last].all()
        assert grid[last] <= _boundary(observer, variance, damping_rate) < grid[last + 1]


def test_stable_ratios_without_damping_have_both_ends():
    """K_2 = 0: 0.41 to 1.72 on the same grid (paper notes 8)."""
    grid = 10.0 ** (np.arange(-68, 69) / 34.0)
    stable = np.flatnonzero(_stable_ratios(0.0, 0.6, grid))
    assert grid[stable[0]] == pytest.approx(0.41, abs=0.005)
    assert grid[stable[-1]] == pytest.approx(1.72, abs=0.005)
    found = _boundary(observer_of(damping_rate=0.0), 0.6, 0.0)
    assert grid[stable[-1]] <= found < grid[stable[-1] + 1]


def _growth(observer, variance, plant, measured_rate):
    """
    Run the loop in time and return how its force grows from one half of the run to the other.

    The contact is integrated by Runge-Kutta in quarters of a period, and the observer is the one
    that the controller runs: nothing here is shared with the matrix.
    """
    k_s, c, mobility, tool = (float(value.item()) for value in (
        plant.stiffness, plant.damping, plant.mobility, plant.tool_inertia))

    def change(depth, speed, acceleration):
        return acceleration - plant.damping_rate * speed - mobility * (k_s * depth + c * speed)

    for _ in range(1000):  # settle the gain first, to 1e-7 in 400
        observer.update(0.0, variance)
    observer.x_est[:] = 0.0
    observer.command(0.0)
    depth, speed = 1.0 / k_s, 0.0
    forces, commands = [], []
    steps, dt = 4, H / 4
    waiting = round(plant.delay / dt)

    def acting(step):
        index = (step - waiting) // steps
        return commands[index] if index >= 0 else 0.0

    for k in range(4000):
        force = (k_s * depth + c * speed
                 + tool * change(depth, speed, acting(steps * k - 1)))
        forces.append(force)
        observer.update(force, variance)
        commands.append(observer.command(0.0) + mobility * float(observer.x_est[0])
                        - measured_rate * speed)
        for step in range(steps * k, steps * (k + 1)):
            u = acting(step)
            v1, a1 = speed, change(depth, speed, u)
            v2 = speed + 0.5 * dt * a1
            a2 = change(depth + 0.5 * dt * v1, v2, u)
            v3 = speed + 0.5 * dt * a2
            a3 = change(depth + 0.5 * dt * v2, v3, u)
            v4 = speed + dt * a3
            a4 = change(depth + dt * v3, v4, u)
            depth += dt / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
            speed += dt / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    forces = np.abs(forces)
    return forces[2000:].max() / forces[1000:2000].max()


@pytest.mark.parametrize('values', [
    {}, {'commanded': True}, {'damping': 30.0}, {'mobility': 0.05}, {'tool': 0.2},
    {'delay': 2.5 * H, 'tool': 0.2}, {'delay': 0.5 * H, 'tool': 0.2},
    {'commanded': True, 'damping': 30.0, 'mobility': 0.05, 'tool': 0.2}])
@pytest.mark.parametrize(('damping_rate', 'variance'), [(20.0, 0.6), (60.0, 100.0)])
def test_boundary_is_where_the_loop_in_time_begins_to_grow(damping_rate, variance, values):
    """Three percent inside it dies away, three percent outside it grows."""
    upper = _boundary(observer_of(damping_rate=damping_rate), variance, damping_rate, **values)
    assert 1.0 < upper < 100.0
    own = {**values}
    rates = (0.0, damping_rate) if own.pop('commanded', False) else (damping_rate, 0.0)
    for ratio, grows in ((0.97 * upper, False), (1.03 * upper, True)):
        growth = _growth(observer_of(damping_rate=damping_rate), variance,
                         _plant(ratio, rates[0], **own), rates[1])
        assert (growth > 1.0) == grows


def test_boundary_depends_on_where_the_damping_acts():
    """Delayed damping helps less with little of it (paper notes 13)."""
    observer = observer_of()
    assert _boundary(observer, 0.6, commanded=True) < 0.9 * _boundary(observer, 0.6)


def test_boundary_shrinks_with_a_delay_that_the_model_does_not_have():
    """Each tick of actuator delay beyond T_d costs stiffness."""
    uppers = [_boundary(observer_of(), 0.6, delay=ticks * H) for ticks in range(2, 5)]
    assert uppers[0] > uppers[1] > uppers[2]


def test_boundary_of_a_loop_that_is_never_stable_is_none():
    """Far too much delay leaves nothing at a ratio of 1."""
    assert _boundary(observer_of(), 0.6, delay=20 * H) == 0.0


def test_last_stable_is_below_the_first_change_of_the_verdict():
    low, high = last_stable(lambda ratio: ratio < 3.7 or ratio > 9.0, [1.0, 5.0, 20.0], 1e-6)
    assert low < 3.7 <= high < low * (1.0 + 1e-6)
    assert last_stable(lambda ratio: True, [1.0, 2.0], 0.1) == (np.inf, np.inf)
    assert bisect(lambda ratio: ratio < 3.7, 1.0, 20.0, 1e-6) == pytest.approx((3.7, 3.7))


def _arm(mobility, delay=1):
    count = len(mobility)
    return LinearArmPlant(np.array(mobility), np.full(count, 1.5 * K), np.full(count, 30.0),
                          0.5 * np.eye(count), delay * H)


def _arm_loop(plant, observer):
    law = steady_law(observer.design, steady_gain(observer, 0.6))
    return closed_loop(plant, law, 20.0, H)


def test_loop_of_uncoupled_contacts_is_that_of_each():
    both = _arm_loop(_arm(np.diag([0.1, 0.4])), observer_of())
    each = [_arm_loop(_arm([[mobility]]), observer_of()) for mobility in (0.1, 0.4)]
    assert spectral_radius(both) == pytest.approx(max(map(spectral_radius, each)))


@pytest.mark.parametrize('delay', [0, 1, 2, 3])
def test_loop_is_the_observer_on_the_coupled_contacts_in_time(delay):
    """One period of the matrix is one tick of the AOBs on a finely integrated plant."""
    B, aob = np.array([[0.3, 0.1], [0.1, 0.2]]), observer_of()
    matrix, gain = _arm_loop(_arm(B, delay), aob), steady_gain(aob, 0.6)
    state = np.random.default_rng(3).standard_normal(matrix.shape[0]) * 1e-3
    x, line = state[:4], list(state[4:4 + 2 * delay].reshape(-1, 2))
    measured, predicted = state[4 + 2 * delay:6 + 2 * delay], state[6 + 2 * delay:].reshape(2, -1)
    estimates = predicted + np.outer(measured - predicted[:, 0], gain)
    line.append(-estimates @ aob.feedback - 20.0 * x[2:] + B @ estimates[:, 0])
    acting = line.pop(0)

    def motion(x):
        return np.concatenate([x[2:], acting - B @ (1.5 * K * x[:2] + 30.0 * x[2:])])

    steps = 5000
    for _ in range(steps):
        x = x + H / steps * motion(x + 0.5 * H / steps * motion(x))
    force = 1.5 * K * x[:2] + 30.0 * x[2:] + 0.5 * motion(x)[2:]
    predicted = estimates @ aob.Phi_c.T
    np.testing.assert_allclose(
        matrix @ state, np.concatenate([x, *line, force, predicted.ravel()]), rtol=1e-6, atol=1e-9)


def test_plant_of_the_wrong_shape_is_refused():
    with pytest.raises(ShapeError, match='mobility'):
        LinearArmPlant(np.eye(3), np.ones(2), np.ones(2), np.eye(2), H)
    with pytest.raises(ConfigError, match='delay'):
        LinearArmPlant(np.eye(2), np.ones(2), np.ones(2), np.eye(2), -H)


@pytest.mark.parametrize('variance', [0.0, -1.0, float('nan'), float('inf')])
def test_steady_gain_refuses_a_variance_out_of_range(variance):
    """The message names it."""
    with pytest.raises(ConfigError, match='^noise_variance: expected a positive number'):
        steady_gain(observer_of(), variance)
