"""What follows from an innovation, against the observer's own arrays."""

from force_loop import observer_of
from multicontact_control.force.noise import Innovation
import numpy as np
import pytest


def test_innovation_gives_the_residual_and_the_posterior_variance_of_the_observer():
    """Check e = y - C x and C P C^T, from r, C P_1 C^T and R alone."""
    observer = observer_of()
    rng = np.random.default_rng(17)
    for _ in range(20):
        force, variance = rng.standard_normal(), 10.0 ** rng.uniform(-3, 3)
        observer.update(force, variance)
        observer.command(1.0)
    innovation = Innovation(
        np.array([observer.innovation]), np.array([observer.prior_variance]),
        np.array([observer.variance_used]))
    assert innovation.residual[0] == pytest.approx(force - observer.x_est[0], rel=1e-9)
    assert innovation.posterior_variance[0] == pytest.approx(observer.P[0, 0], rel=1e-9)


def test_innovation_of_an_inactive_contact_is_marked_and_harmless():
    """R used of 0 means that there is none; nothing divides by it."""
    innovation = Innovation(np.zeros(2), np.array([0.0, 0.4]), np.array([0.0, 0.6]))
    np.testing.assert_array_equal(innovation.valid, [False, True])
    np.testing.assert_allclose(innovation.residual, 0.0)
    np.testing.assert_allclose(innovation.posterior_variance, [0.0, 0.24])
