"""What bounds the motion near stops and singular postures, against independent references."""

from arms import controller_config, HOME
from hypothesis import given
from hypothesis import strategies as st
from multicontact_control.dynamics.operational_space import compute_mobility_gradient
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.paths import find_config_folder
from multicontact_control.supervision import bounds
import numpy as np
import pytest

ROBOT = RobotModel(controller_config().robot, find_config_folder())


def factors(state):
    """Return L with M = L L^T, and L^-1 J^T."""
    L = np.linalg.cholesky(state.mass_matrix)
    return L, np.linalg.solve(L, state.jacobian.T)


@pytest.mark.parametrize('index', range(3))
def test_mobility_gradient_agrees_with_finite_differences(index):
    rng = np.random.default_rng(index)
    h = 1e-6
    q = HOME + 0.3 * rng.standard_normal(6)
    state = ROBOT.update(q, np.zeros(6))

    def eigenvalue(at):
        J = ROBOT.update(at, np.zeros(6)).jacobian
        return np.linalg.eigvalsh(J @ np.linalg.solve(state.mass_matrix, J.T))[index]

    direction = np.linalg.eigh(
        state.jacobian @ np.linalg.solve(state.mass_matrix, state.jacobian.T)
    )[1][:, index]
    gradient = np.empty(6)
    compute_mobility_gradient(
        state.jacobian, *factors(state), direction.copy(), np.empty(6), gradient
    )
    expected = [
        (eigenvalue(q + step) - eigenvalue(q - step)) / (2.0 * h)
        for step in h * np.eye(6)
    ]
    np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-7)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 8))
def test_least_change_fulfils_the_conditions_of_an_optimum(seed, count):
    """Karush, Kuhn and Tucker: feasible, stationary, multipliers of active bounds alone."""
    rng = np.random.default_rng(seed)
    n = 7
    root = rng.standard_normal((n, n))
    H = root @ root.T + 1e-3 * np.eye(n)
    R = rng.standard_normal((count, n))
    excess = rng.standard_normal(count)
    if count > n:
        R, excess = R[:n], excess[:n]
    space = np.zeros(1, dtype=bounds.BOUND_SPACE)[0]
    m = len(R)
    space['cost'][:n, :n], space['rows'][:m, :n], space['excess'][:m] = H, R, excess
    assert bounds.solve_least_change(n, m, space)
    multipliers, change = space['multipliers'][:m], space['change'][:n]
    slack = -excess - R @ change
    scale = 1.0 + np.abs(excess).max()
    assert slack.min() > -1e-6 * scale
    assert multipliers.min() >= 0.0
    assert np.abs(multipliers * slack).max() < 1e-5 * scale * (1.0 + multipliers.max())
    residual = H @ change + R.T @ multipliers
    assert np.abs(residual).max() < 1e-6 * (1.0 + np.abs(H @ change).max())


@pytest.mark.parametrize('speed', [0.1, 1.0, 5.0])
def test_allowed_speed_stops_a_joint_without_more_than_its_braking(speed):
    """A joint that follows the allowed speed comes to rest at the stop, from any speed."""
    distance = next(
        d
        for d in np.linspace(0.0, 10.0, 100_001)
        if bounds.allowed_stop_speed(d) >= speed
    )
    h = 1e-4
    fastest_change = 0.0
    before = bounds.allowed_stop_speed(distance)
    for _ in range(60_000):
        allowed = bounds.allowed_stop_speed(distance)
        fastest_change = max(fastest_change, abs(allowed - before) / h)
        before = allowed
        distance -= h * allowed
    assert fastest_change < 1.01 * bounds.JOINT_BRAKING
    assert 0.0 <= distance < 1e-3
    assert bounds.allowed_stop_speed(-0.01) < 0.0  # what is beyond the stop comes back
