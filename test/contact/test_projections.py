"""Projections against the paper's example (eq. 22) and their defining properties (eqs 13-15)."""

from contact_space import allocate_force, contact_normals, contact_rates, projections
import equations
from equations import free_motions, general_projections
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


def test_euclidean_projections_satisfy_the_papers_identities(N):
    """Equations 11-15, with T from a null space."""
    p = projections(N)
    T = free_motions(N)
    np.testing.assert_allclose(p.Omega_m, T @ np.linalg.solve(T.T @ T, T.T), atol=1e-12)
    for product in (p.Omega_m @ p.Omega_f, p.Omega_f @ p.Omega_m):
        np.testing.assert_allclose(product, 0.0, atol=1e-12)
    np.testing.assert_allclose(p.Omega_f @ p.Omega_f, p.Omega_f, atol=1e-12)
    np.testing.assert_allclose(p.Omega_m @ p.Omega_m, p.Omega_m, atol=1e-12)
    np.testing.assert_allclose(p.Omega_c, p.Omega_f, atol=1e-12)


def test_projections_keep_contact_wrenches_and_free_motions(N, Lambda):
    """Omega_f N = N and Omega_m T = T in either metric."""
    T = free_motions(N)
    for p in (projections(N), projections(N, Lambda)):
        np.testing.assert_allclose(p.Omega_f @ N, N, atol=1e-12)
        np.testing.assert_allclose(p.Omega_m @ T, T, atol=1e-12)


def test_motion_command_accelerates_no_contact_point(N, Lambda, rng):
    """Omega_m f_t* leaves every contact normal unaccelerated (P04 sec. 2.2)."""
    for p in (projections(N), projections(N, Lambda)):
        acceleration = p.Omega_m @ rng.standard_normal(6)
        np.testing.assert_allclose(N.T @ acceleration, 0.0, atol=1e-12)


def test_inertia_projections_are_the_general_form_with_inertial_complements(N, Lambda):
    """T' = Lambda^-1 N, N' = Lambda T in the general form of eqs 9-12."""
    T = free_motions(N)
    general = general_projections(N, T, Lambda @ T, np.linalg.solve(Lambda, N))
    p = projections(N, Lambda)
    np.testing.assert_allclose(p.Omega_f, general.Omega_f, atol=1e-12)
    np.testing.assert_allclose(p.Omega_m, general.Omega_m, atol=1e-12)


def test_inertia_projections_make_no_contact_force_by_motion(N, Lambda, rng):
    """The wrench of the force part lies in the span of N: Lambda Omega_c a = N x."""
    p = projections(N, Lambda)
    wrench = Lambda @ p.Omega_c @ rng.standard_normal(6)
    np.testing.assert_allclose(p.Omega_f @ wrench, wrench, atol=1e-11)


def test_general_projections_with_euclidean_complements_are_the_papers(N):
    """N' = T, T' = N (P04 after eq. 8)."""
    T = free_motions(N)
    general = general_projections(N, T, T, N)
    p = projections(N)
    np.testing.assert_allclose(general.Omega_f, p.Omega_f, atol=1e-12)
    np.testing.assert_allclose(general.Omega_m, p.Omega_m, atol=1e-12)


def test_decoupled_allocation_drives_each_contact_point_alone(N, Lambda, rng):
    """N^T Omega_c f_c* = alpha*, in either metric; `paper` couples the contacts."""
    alpha_star = rng.standard_normal(3)
    for p in (projections(N), projections(N, Lambda)):
        f_c = allocate_force(N, alpha_star, 'decoupled')
        np.testing.assert_allclose(N.T @ p.Omega_c @ f_c, alpha_star, atol=1e-12)
    coupled = N.T @ allocate_force(N, alpha_star, 'paper')
    np.testing.assert_allclose(coupled, N.T @ N @ alpha_star, atol=1e-12)
    assert np.abs(coupled - np.diag(N.T @ N) * alpha_star).max() > 0.1


@pytest.mark.parametrize('allocation', ['paper', 'decoupled'])
def test_contact_rates_belong_to_the_allocations_coordinates(N, rng, allocation):
    """An acceleration allocated to u raises the rate by u."""
    u = rng.standard_normal(3)
    twist = allocate_force(N, u, allocation)
    np.testing.assert_allclose(contact_rates(N, twist, allocation), u, atol=1e-12)


def test_projections_are_those_of_the_equations_in_full_matrices(N, Lambda):
    for found, wanted in ((projections(N), equations.euclidean_projections(N)),
                          (projections(N, Lambda), equations.inertia_projections(N, Lambda))):
        np.testing.assert_allclose(found.Omega_f, wanted.Omega_f, atol=1e-12)
        np.testing.assert_allclose(found.Omega_m, wanted.Omega_m, atol=1e-12)


def test_no_contact_leaves_all_motion_free():
    """With no contact Omega_m = 1 and forces are 0."""
    N = np.zeros((6, 0))
    for found in (projections(N), projections(N, np.eye(6))):
        np.testing.assert_array_equal(found.Omega_m, np.eye(6))
        np.testing.assert_array_equal(found.Omega_f, np.zeros((6, 6)))
    np.testing.assert_array_equal(allocate_force(N, np.zeros(0), 'decoupled'), np.zeros(6))
