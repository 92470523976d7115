from multicontact_control.errors import ConfigError, ShapeError
from multicontact_control.force.contact_loop import closed_loop, LinearArmPlant, spectral_radius
from multicontact_control.force.linear_loop import (
    closed_loop_matrix,
    RealContact,
    steady_gain,
)
from multicontact_control.force.observer import design_observer
from multicontact_control.force.plant_model import design_force_loop
import numpy as np
import pytest

H = 0.002


def observer():
    return design_observer(design_force_loop(
        6000.0, damping_rate=20.0, input_delay=0.006, period=H, time_constant=0.02))


def surroundings(mobility, *, stiffness=9000.0, damping=30.0, tool=0.0, delay=1):
    count = len(mobility)
    return LinearArmPlant(
        mobility=np.array(mobility), stiffness=np.full(count, stiffness),
        damping=np.full(count, damping), tool_inertia=tool * np.eye(count), delay_ticks=delay)


def loop_of(plant):
    return closed_loop(plant, observer(), steady_gain(observer(), 0.6), 20.0, H)


def large(matrix):
    """Return the eigenvalues that are not those of a delay line."""
    values = np.linalg.eigvals(matrix)
    return np.sort_complex(values[np.abs(values) > 0.05])


@pytest.mark.parametrize('delay', [0, 1, 3])
@pytest.mark.parametrize('mass', [2.5, 1e12])
def test_contact_loop_of_one_contact_is_that_of_linear_loop(delay, mass):
    contact = RealContact(
        stiffness=9000.0, damping_rate=20.0, input_delay=delay * H, period=H,
        damping='commanded', contact_damping=30.0, effective_mass=mass)
    single = closed_loop_matrix(observer(), steady_gain(observer(), 0.6), contact)
    np.testing.assert_allclose(
        large(loop_of(surroundings([[1.0 / mass]], delay=delay))), large(single), atol=1e-6)


def test_contact_loop_of_uncoupled_contacts_is_that_of_each():
    both = loop_of(surroundings(np.diag([0.1, 0.4]), tool=0.5))
    each = [loop_of(surroundings([[mobility]], tool=0.5)) for mobility in (0.1, 0.4)]
    assert spectral_radius(both) == pytest.approx(max(map(spectral_radius, each)))


@pytest.mark.parametrize('delay', [0, 1, 2, 3])
def test_contact_loop_is_the_observer_on_the_simulated_contact(delay):
    """One period of the matrix is one tick of the AOB on a finely integrated plant."""
    plant = surroundings([[0.3]], tool=0.5, delay=delay)
    matrix, gain, aob = loop_of(plant), steady_gain(observer(), 0.6), observer()
    rng = np.random.default_rng(3)
    state = rng.standard_normal(matrix.shape[0]) * 1e-3
    x, line, estimate = state[:2], list(state[2:2 + delay]), state[2 + delay:]
    w = -aob.feedback @ estimate - 20.0 * x[1] + 0.3 * estimate[0]
    line.append(w)
    acting = line.pop(0)
    steps = 20000
    for _ in range(steps):
        middle = x + 0.5 * H / steps * motion(x, acting)
        x = x + H / steps * motion(middle, acting)
    force = 9000.0 * x[0] + 30.0 * x[1] + 0.5 * motion(x, acting)[1]
    predicted = aob.Phi_c @ estimate
    estimate = predicted + gain * (force - predicted[0])
    np.testing.assert_allclose(
        matrix @ state, np.concatenate([x, line, estimate]), rtol=1e-6, atol=1e-9)


def motion(x, acting):
    return np.array([x[1], acting - 0.3 * (9000.0 * x[0] + 30.0 * x[1])])


def test_surroundings_of_the_wrong_shape_are_refused():
    with pytest.raises(ShapeError, match='mobility'):
        LinearArmPlant(np.eye(3), np.ones(2), np.ones(2), np.eye(2))
    with pytest.raises(ConfigError, match='delay_ticks'):
        LinearArmPlant(np.eye(2), np.ones(2), np.ones(2), np.eye(2), -1)
