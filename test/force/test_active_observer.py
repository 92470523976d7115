"""The active observer against scipy's Riccati solver and its own promises."""

from multicontact_control.errors import ConfigError
from multicontact_control.force.active_observer import active_state_matrix, ActiveObserver
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


def test_update_follows_equations_37_to_40_literally(loop):
    """One update, written out again with full matrices."""
    observer = ActiveObserver(loop)
    observer.reset(1.0)
    observer.update(1.0, 0.6)
    observer.command(2.0)
    x, P, r = observer.x_est.copy(), observer.P.copy(), loop.L[0] * 2.0
    Phi_c = np.zeros((6, 6))
    Phi_c[:5, :5] = loop.plant.Phi - np.outer(loop.plant.Gamma, loop.L)
    Phi_c[5, 5] = 1.0
    Phi_n = np.block([[loop.plant.Phi, loop.plant.Gamma[:, None]], [np.zeros((1, 5)), 1.0]])
    C = np.array([[1.0, 0, 0, 0, 0, 0]])
    P_1 = Phi_n @ P @ Phi_n.T + 1e-3 * np.eye(6)
    K = P_1 @ C.T / (C @ P_1 @ C.T + 0.3)
    x_pred = Phi_c @ x + np.append(loop.plant.Gamma, 0.0) * r
    observer.update(1.7, 0.3)
    np.testing.assert_allclose(
        observer.x_est, x_pred + K[:, 0] * (1.7 - x_pred[0]), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(observer.P, P_1 - K @ C @ P_1, rtol=1e-10, atol=1e-15)
    expected = r - np.append(loop.L, 1.0) @ observer.x_est
    observer_input = observer.command(2.0)
    assert observer_input == pytest.approx(expected, rel=1e-12)


def test_observer_rejects_a_constant_input_disturbance(loop):
    """The active state finds p and takes it out: no error at rest (P04 sec. 4)."""
    observer = ActiveObserver(loop)
    forces = _simulate(loop, observer, 1500, disturbance=np.full(1500, 0.05))
    assert forces[-1] == pytest.approx(10.0, abs=1e-6)
    assert observer.disturbance_est == pytest.approx(0.05, rel=1e-4)


def test_without_active_state_a_disturbance_leaves_an_error(loop):
    """Order 0 is plain pole placement."""
    observer = ActiveObserver(loop, order=0)
    forces = _simulate(loop, observer, 1500, disturbance=np.full(1500, 0.05))
    assert abs(forces[-1] - 10.0) > 0.5
    assert observer.disturbance_est == 0.0


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
    assert observer.force_est == 7.0
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
            error.append(observer.force_est - x[0])
        x = loop.plant.Phi @ x + loop.plant.Gamma * u
    assert np.std(error) < 0.5


@pytest.mark.parametrize(('options', 'field'), [
    ({'order': 4}, 'active_state_order'), ({'process_noise': 0.0}, 'process_noise'),
    ({'initial_covariance': -1.0}, 'initial_covariance')])
def test_observer_refuses_options_out_of_range(loop, options, field):
    """The message names the field."""
    with pytest.raises(ConfigError, match=f'^{field}: expected'):
        ActiveObserver(loop, **options)
