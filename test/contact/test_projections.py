"""Projections against the paper's example (eq. 22) and their defining properties (eqs 13-15)."""

from contact_space import allocate_force, contact_normals, contact_rates, projections
import equations
import numpy as np
import pytest


@pytest.fixture
def rng():
    return np.random.default_rng(1)


@pytest.fixture
def N(rng):
    """Three contacts in general position, so that N^T N is full."""
    normals = rng.standard_normal((3, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return contact_normals(normals, rng.standard_normal((3, 3)))


@pytest.fixture
def Lambda(rng):
    root = rng.standard_normal((6, 6))
    return root @ root.T + 6.0 * np.eye(6)


def test_euclidean_projections_of_the_planar_example():
    """N = [0 1 -1]^T, Omega_f and Omega_m to the digit (P04 eq. 22)."""
    found = projections(np.array([[0.0], [1.0], [0.0], [0.0], [0.0], [-1.0]]))
    plane = np.ix_([0, 1, 5], [0, 1, 5])  # x, y and the rotation about z
    np.testing.assert_allclose(
        found.Omega_f[plane], [[0, 0, 0], [0, 0.5, -0.5], [0, -0.5, 0.5]], atol=1e-15)
    np.testing.assert_allclose(
        found.Omega_m[plane], [[1, 0, 0], [0, 0.5, 0.5], [0, 0.5, 0.5]], atol=1e-15)


def test_planar_example_normal_comes_from_the_contact_geometry():
    """With l = sqrt(2), gamma = 45 deg: N = [0 1 -1]^T in x, y, rotation about z (P04 eq. 18)."""
    N = contact_normals(np.array([[0.0, 1.0, 0.0]]), np.array([[1.0, 1.0, 0.0]]))[:, 0]
    np.testing.assert_allclose(N[[0, 1, 5]], [0.0, 1.0, -1.0], atol=1e-15)


@pytest.mark.parametrize('allocation', ['paper', 'decoupled'])
def test_contact_rates_belong_to_the_allocations_coordinates(N, rng, allocation):
    u = rng.standard_normal(3)
    twist = allocate_force(N, u, allocation)
    np.testing.assert_allclose(contact_rates(N, twist, allocation), u, atol=1e-12)


def test_projections_are_those_of_the_equations_in_full_matrices(N, Lambda):
    for found, wanted in ((projections(N), equations.euclidean_projections(N)),
                          (projections(N, Lambda), equations.inertia_projections(N, Lambda))):
        np.testing.assert_allclose(found.Omega_f, wanted.Omega_f, atol=1e-12)
        np.testing.assert_allclose(found.Omega_m, wanted.Omega_m, atol=1e-12)
