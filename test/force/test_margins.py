"""The linear loop's stability against Riccati, the paper notes and the loop run in time."""

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
import pytest

K = 6000.0
DELAY_TICKS = 3


def law_of(observer, variance):
    return make_steady_law(
        observer.design, solve_steady_gain(observer.design, variance)
    )


def loop_of(law, ratio=1.0, damping_rate=20.0, delay=DELAY_TICKS * H):
    """Return the loop of one contact whose plant is the one of eq. 32, times a ratio."""
    plant = LinearArmPlant(
        np.zeros((1, 1)),
        np.array([ratio * K]),
        np.zeros(1),
        np.zeros((1, 1)),
        delay,
        damping_rate,
    )
    return closed_loop(plant, law, 0.0, H)


def boundary(law, **values):
    """Return the last stable ratio of the real stiffness to that of the design."""
    return find_last_stable(
        lambda ratio: spectral_radius(loop_of(law, ratio, **values)) < 1.0,
        np.geomspace(1.0, 100.0, 95).tolist(),
        1e-4,
    )[0]


@pytest.mark.parametrize('order', range(4))
@pytest.mark.parametrize('variance', [1e-3, 0.6, 100.0])
def test_steady_gain_is_where_the_observer_settles(order, variance):
    """The Riccati equation and the recursion agree."""
    observer = observer_of(order)
    for _ in range(4000):  # of 1900, in the slowest case, to 1e-7
        observer.update(0.0, variance)
    settled = observer.P[:, 0] / variance  # K = P C^T / R
    np.testing.assert_allclose(
        solve_steady_gain(observer.design, variance), settled, rtol=1e-6, atol=1e-12
    )


@pytest.mark.parametrize(
    ('damping_rate', 'at_rest', 'in_motion'),
    [(20.0, 1.97, 3.16), (60.0, 2.41, 4.44), (100.0, 2.58, 5.44)],
)
def test_stable_ratios_are_those_of_the_paper_notes(damping_rate, at_rest, in_motion):
    """
    Paper notes 8 tell the last stable ratio of a grid with 34 steps to the decade.

    The boundary itself lies between that and the next point of the grid, 7 % above.
    """
    grid = 10.0 ** (np.arange(-68, 69) / 34.0)
    for variance, noted in ((0.6, at_rest), (100.0, in_motion)):
        law = law_of(observer_of(damping_rate=damping_rate), variance)
        stable = np.array(
            [spectral_radius(loop_of(law, ratio, damping_rate)) < 1.0 for ratio in grid]
        )
        last = np.flatnonzero(~stable)[0] - 1
        assert grid[last] == pytest.approx(noted, abs=0.005)
        assert stable[:last].all()
        assert grid[last] <= boundary(law, damping_rate=damping_rate) < grid[last + 1]


@pytest.mark.parametrize('delay', [0.0, 0.5, 1.0, 2.5, 3.0])
def test_loop_is_the_observer_on_coupled_contacts_in_time(delay):
    """One period of the matrix is one tick of the AOBs on a finely integrated plant."""
    k, c, tool, own, aob = 1.5 * K, 30.0, 0.5, 5.0, observer_of()
    B, gain = np.array([[0.3, 0.1], [0.1, 0.2]]), solve_steady_gain(aob.design, 0.6)
    plant = LinearArmPlant(
        B, np.full(2, k), np.full(2, c), tool * np.eye(2), delay * H, own
    )
    matrix = closed_loop(plant, make_steady_law(aob.design, gain), 20.0, H)
    state, under_way = (
        np.random.default_rng(3).standard_normal(len(matrix)),
        int(np.ceil(delay)),
    )
    state *= 1e-3
    x, measured, predicted = np.split(state, [4 + 2 * under_way, 6 + 2 * under_way])
    x, line = x[:4], list(x[4:].reshape(-1, 2))
    predicted = predicted.reshape(2, -1)
    estimates = predicted + np.outer(measured - predicted[:, 0], gain)
    line.append(-estimates @ aob.design.feedback - 20.0 * x[2:] + B @ estimates[:, 0])
    late = (
        delay - under_way + 1 if under_way else 1.0
    )  # share of the period of the oldest input

    def motion(x, acting):
        return np.concatenate(
            [x[2:], acting - own * x[2:] - B @ (k * x[:2] + c * x[2:])]
        )

    steps = 5000
    for step in range(steps):
        acting = line[0] if step < late * steps else line[1]
        x = x + H / steps * motion(x + 0.5 * H / steps * motion(x, acting), acting)
    force = k * x[:2] + c * x[2:] + tool * motion(x, acting)[2:]
    predicted = estimates @ aob.design.Phi_c.T
    np.testing.assert_allclose(
        matrix @ state,
        np.concatenate([x, *line[1:], force, predicted.ravel()]),
        rtol=1e-6,
        atol=1e-9,
    )
