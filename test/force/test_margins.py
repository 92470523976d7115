"""The linear loop's stability against Riccati, a scan of ratios and the loop run in time."""

from force_loop import H, observer_of
from multicontact_control.force.laws.aob import make_steady_law
from multicontact_control.force.margins import (
    closed_loop,
    find_last_stable,
    LinearArmPlant,
    spectral_radius,
)
from multicontact_control.force.observer import solve_steady_gain
import numpy as np
from numpy.testing import assert_allclose
import pytest

K = 6000.0
DELAY_TICKS = 3


def law_of(observer, variance):
    gain = solve_steady_gain(observer.design, variance)
    return make_steady_law(observer.design, gain)


def loop_of(law, ratio=1.0, damping_rate=20.0, delay=DELAY_TICKS * H):
    """Return the loop of one contact whose plant is the one of eq. 32, times a ratio."""
    k = np.array([ratio * K])
    no_coupling = np.zeros((1, 1))
    plant = LinearArmPlant(
        no_coupling, k, np.zeros(1), np.zeros((1, 1)), delay, damping_rate
    )
    return closed_loop(plant, law, 0.0, H)


def boundary(law, **values):
    """Return the last stable ratio of the real stiffness to that of the design."""

    def is_stable(ratio):
        return spectral_radius(loop_of(law, ratio, **values)) < 1.0

    ratios = np.geomspace(1.0, 100.0, 95).tolist()
    last_stable, _ = find_last_stable(is_stable, ratios, 1e-4)
    return last_stable


@pytest.mark.parametrize('order', range(4))
@pytest.mark.parametrize('variance', [1e-3, 0.6, 100.0])
def test_steady_gain_is_where_the_observer_settles(order, variance):
    """The Riccati equation and the recursion agree."""
    observer = observer_of(order)
    for _ in range(4000):  # of 1900, in the slowest case, to 1e-7
        observer.update(0.0, variance)
    settled = observer.P[:, 0] / variance  # K = P C^T / R
    gain = solve_steady_gain(observer.design, variance)
    assert_allclose(gain, settled, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ('damping_rate', 'variance', 'noted'),
    [
        (20.0, 0.6, 1.97),
        (60.0, 0.6, 2.41),
        (100.0, 0.6, 2.58),
        (20.0, 100.0, 3.16),
        (60.0, 100.0, 4.44),
        (100.0, 100.0, 5.44),
    ],
)
def test_stable_ratios_end_where_a_scan_of_ratios_does(damping_rate, variance, noted):
    """The boundary is within one of 34 steps to the decade: between a ratio and 7 % above."""
    grid = 10.0 ** (np.arange(-68, 69) / 34.0)
    law = law_of(observer_of(damping_rate=damping_rate), variance)
    radii = [spectral_radius(loop_of(law, ratio, damping_rate)) for ratio in grid]
    stable = np.array(radii) < 1.0
    last = np.flatnonzero(~stable)[0] - 1
    assert grid[last] == pytest.approx(noted, abs=0.005)
    assert stable[:last].all()
    assert grid[last] <= boundary(law, damping_rate=damping_rate) < grid[last + 1]


@pytest.mark.parametrize('delay', [0.0, 0.5, 1.0, 2.5, 3.0])
def test_loop_is_the_observer_on_coupled_contacts_in_time(delay):
    """One period of the matrix is one tick of the AOBs on a finely integrated plant."""
    k = 1.5 * K
    c = 30.0
    tool = 0.5
    own = 5.0
    aob = observer_of()
    gain = solve_steady_gain(aob.design, 0.6)
    B = np.array([[0.3, 0.1], [0.1, 0.2]])
    plant = LinearArmPlant(
        B, np.full(2, k), np.full(2, c), tool * np.eye(2), delay * H, own
    )
    matrix = closed_loop(plant, make_steady_law(aob.design, gain), 20.0, H)
    under_way = int(np.ceil(delay))
    state = 1e-3 * np.random.default_rng(3).standard_normal(len(matrix))
    ends = [4, 4 + 2 * under_way, 6 + 2 * under_way]
    x, inputs, measured, predicted = np.split(state, ends)
    line = list(inputs.reshape(-1, 2))
    predicted = predicted.reshape(2, -1)
    unexpected = measured - predicted[:, 0]
    estimates = predicted + np.outer(unexpected, gain)
    command = -estimates @ aob.design.feedback
    coupled = B @ estimates[:, 0]
    line.append(command - 20.0 * x[2:] + coupled)
    oldest_share = 1.0  # of the period in which the oldest input acts
    if under_way:
        oldest_share = delay - under_way + 1

    def motion(x, acting):
        depth, speed = np.split(x, 2)
        acceleration = acting - own * speed - B @ (k * depth + c * speed)
        return np.concatenate([speed, acceleration])

    steps = 5000
    step_time = H / steps
    for step in range(steps):
        acting = line[0]
        if step >= oldest_share * steps:
            acting = line[1]
        middle = x + 0.5 * step_time * motion(x, acting)
        x = x + step_time * motion(middle, acting)
    force = k * x[:2] + c * x[2:] + tool * motion(x, acting)[2:]
    predicted = estimates @ aob.design.Phi_c.T
    expected = np.concatenate([x, *line[1:], force, predicted.ravel()])
    assert_allclose(matrix @ state, expected, rtol=1e-6, atol=1e-9)
