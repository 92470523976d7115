"""
Normals, projections and allocation against the paper (P04 eqs 2-22, 30-31).

The compiled functions never form the matrices: here they are made column by column.
"""

import equations
from equations import free_motions, operational_stiffness
from force_loop import design_force_loop
from hypothesis import given
from hypothesis import strategies as st
from multicontact_control.algebra import multiply_vector, solve_cholesky
from multicontact_control.contact.geometry import normal_space, project_on_contacts
from multicontact_control.contact.projections import (
    compose_acceleration,
    CONTACT_PROJECTION,
    factorise_contacts,
)
from multicontact_control.control.law import apply_force_law, convert_to_coordinates
from multicontact_control.records import CONTACT, LAW
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

INPUTS = np.array([0.7, -0.4, 1.1])  # a_i [m/s^2]


def contact_normals(normals_world, levers_world):
    """Return N of contacts a lever away from an operational point with the world's axes."""
    contacts = np.zeros(len(normals_world), dtype=CONTACT)
    contacts['normal'] = normals_world
    contacts['config']['point'] = -levers_world
    return normal_space(contacts, np.eye(3))


def random_contacts(random, count):
    """Return normals and levers, each of shape (count, 3)."""
    normals, levers = random.standard_normal((2, count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True), levers


def factorise(N, Lambda=None):
    """Return the rows of N^T, those weighted by the metric, and the factor of their product."""
    contacts = np.zeros(N.shape[1], dtype=CONTACT)
    contacts['N'] = N.T
    contacts['answer']['active'] = True
    rows = np.ascontiguousarray(N.T)
    weighted = rows
    if Lambda is not None:
        weighted = np.ascontiguousarray(np.linalg.solve(Lambda, N).T)
    factor = np.empty((len(rows), len(rows)))
    assert factorise_contacts(contacts, False, rows, weighted, factor)
    return rows, weighted, factor


def factorise_record(N, Lambda=None):
    """Return a record of `CONTACT_PROJECTION`, whose factor of N^T N is that of N^T D, too."""
    count = N.shape[1]
    projection = np.zeros(1, dtype=CONTACT_PROJECTION)[0]
    rows, weighted, factor = factorise(N, Lambda)
    projection['rows'][:count] = rows
    projection['weighted_rows'][:count] = weighted
    for name in ('factor', 'weighted_factor'):
        projection[name][:count, :count] = factor
    return projection


def projections(N, Lambda=None):
    """Return Omega_f, as the dual of Omega_c, and Omega_m."""
    projection = factorise_record(N, Lambda)
    count = N.shape[1]
    none = np.zeros(6)
    Omega_m = np.empty((6, 6))
    Omega_c = np.empty((6, 6))
    column = np.empty(6)
    for k, unit in enumerate(np.eye(6)):
        compose_acceleration(projection, count, unit, none, column)
        Omega_m[:, k] = column
        compose_acceleration(projection, count, none, unit, column)
        Omega_c[:, k] = column
    assert_allclose(Omega_c, np.eye(6) - Omega_m, atol=1e-12)
    return Omega_c.T, Omega_m


def allocate_force(N, alpha_star, allocation):
    law = np.zeros(1, dtype=LAW)[0]
    law['decoupled'] = allocation == 'decoupled'
    contacts = np.zeros(N.shape[1], dtype=CONTACT)
    inputs = np.array(alpha_star)
    f_c = np.empty(6)
    apply_force_law(law, np.zeros(6), contacts, factorise_record(N), inputs, f_c)
    return f_c


def coordinate_inputs(N, inputs):
    """Return alpha* of the coordinates for u of the contact points."""
    alpha_star = np.array(inputs)
    convert_to_coordinates(np.ascontiguousarray(N.T), alpha_star)
    return alpha_star


def contact_rates(N, twist, allocation):
    rows, _, factor = factorise(N)
    rates = np.empty(len(rows))
    multiply_vector(rows, twist, rates)
    if allocation == 'paper':
        solve_cholesky(factor, rates)
    return rates


def overlapping(scale=1.0):
    """
    Return N of a floor and two slopes, all pushed by one tool: N_i^T N_j is nowhere 0.

    Lengths are in metres, or in 1/scale of them.
    """
    normals = np.array([[0.0, 0.0, -1.0], [0.0, 0.8, -0.6], [0.6, 0.0, -0.8]])
    levers = np.array([[0.05, -0.02, 0.24], [0.03, -0.16, 0.19], [-0.1, 0.06, 0.2]])
    return contact_normals(normals, scale * levers)


def task_inertia(metric, scale=1.0):
    """Return Lambda, so that a^T Lambda a / scale^2 is the same number in every unit."""
    if metric == 'euclidean':
        return None
    root = np.random.default_rng(26).standard_normal((6, 6))
    inertia = np.diag([4.0] * 3 + [0.1] * 3) + 0.02 * root @ root.T
    inverse = np.diag([1.0 / scale] * 3 + [1.0] * 3)  # of twists in this unit
    return scale**2 * inverse @ inertia @ inverse


@given(st.integers(0, 2**32 - 1), st.integers(0, 4))
def test_contact_normals_are_those_of_the_equation(seed, count):
    normals, levers = random_contacts(np.random.default_rng(seed), count)
    expected = equations.contact_normals(normals, levers)
    assert_allclose(contact_normals(normals, levers), expected, atol=1e-14)


def test_operational_stiffness_of_the_planar_example():
    """k_s = k_env (1 + l^2 sin^2 gamma) (P04 eq. 21): the loop commands so much less."""
    l, gamma = 0.7, 0.6
    normal = np.array([0.0, 1.0, 0.0])
    lever = l * np.array([np.sin(gamma), np.cos(gamma), 0.0])
    expected = 6000.0 * (1.0 + (l * np.sin(gamma)) ** 2)
    k_s = operational_stiffness(6000.0, normal, lever)
    assert k_s == pytest.approx(expected, rel=1e-14)
    N = contact_normals(normal[None], lever[None])
    (alpha_star,) = coordinate_inputs(N, [1.0])
    assert 6000.0 / alpha_star == pytest.approx(expected, rel=1e-14)


def test_force_loop_for_k_s_commands_the_share_k_env_over_k_s():
    """Of what the loop for k_env does (eq. 36), which has the inputs under way likewise."""
    ratio = 1.7
    k_env = design_force_loop(6000.0).L
    k_s = design_force_loop(ratio * 6000.0).L
    assert_allclose(k_s[:2], k_env[:2] / ratio, rtol=1e-9)
    assert_allclose(k_s[2:], k_env[2:], rtol=1e-9)


def stiffnesses(normals, levers):
    """Return k_s of contacts of 6000 N/m."""
    pairs = zip(normals, levers)
    return np.array([operational_stiffness(6000.0, *pair) for pair in pairs])


def test_paper_allocation_of_oblique_contacts_is_that_of_the_equations():
    """N alpha* for k_s couples them: alpha_ddot_i = k_env sum_j N_i^T N_j alpha*_j."""
    normals, levers = random_contacts(np.random.default_rng(3), 3)
    N = equations.contact_normals(normals, levers)
    assert np.abs(np.triu(N.T @ N, 1)).max() > 0.3
    alpha_star = INPUTS * 6000.0 / stiffnesses(normals, levers)
    f_c = allocate_force(N, coordinate_inputs(N, INPUTS), 'paper')
    assert_allclose(f_c, N @ alpha_star, rtol=1e-12)


def test_euclidean_projections_of_the_planar_example():
    """With l = sqrt(2), gamma = 45 deg: N = [0 1 -1]^T, Omega_f and Omega_m (P04 eqs 18, 22)."""
    N = contact_normals(np.array([[0.0, 1.0, 0.0]]), np.array([[1.0, 1.0, 0.0]]))
    assert_allclose(N[[0, 1, 5], 0], [0.0, 1.0, -1.0], atol=1e-15)
    Omega_f, Omega_m = projections(N)
    plane = np.ix_([0, 1, 5], [0, 1, 5])  # x, y and the rotation about z
    expected = np.array([[0, 0, 0], [0, 0.5, -0.5], [0, -0.5, 0.5]])
    assert_allclose(Omega_f[plane], expected, atol=1e-15)
    assert_allclose(Omega_m[plane], np.abs(np.eye(3) - expected), atol=1e-15)


def test_projections_are_those_of_the_equations_in_full_matrices():
    N = overlapping()
    Lambda = task_inertia('inertia')
    euclidean = equations.euclidean_projections(N)
    inertia = equations.inertia_projections(N, Lambda)
    assert_allclose(projections(N), euclidean, atol=1e-11)
    assert_allclose(projections(N, Lambda), inertia, atol=1e-11)


def test_contact_coordinates_are_the_forces_for_any_free_part():
    """N^+ (N alpha + T beta) = alpha (P04 eq. 7)."""
    N = overlapping()
    free_part = free_motions(N) @ np.random.default_rng(0).standard_normal(3)
    rates = contact_rates(N, N @ INPUTS + free_part, 'paper')
    assert_allclose(rates, INPUTS, atol=1e-12)


@pytest.mark.parametrize('allocation', ['paper', 'decoupled'])
def test_contact_rates_invert_the_allocation(allocation):
    N = overlapping()
    rates = contact_rates(N, allocate_force(N, INPUTS, allocation), allocation)
    assert_allclose(rates, INPUTS, atol=1e-12)


def acceleration_of_contacts(allocation, metric, scale):
    """Return N^T Omega_c f_c where lengths are in 1/scale of a metre, back in m/s^2."""
    N = overlapping(scale)
    Omega_f, _ = projections(N, task_inertia(metric, scale))
    f_c = allocate_force(N, scale * INPUTS, allocation)
    return N.T @ Omega_f.T @ f_c / scale


@pytest.mark.parametrize('metric', ['euclidean', 'inertia'])
def test_decoupled_allocation_gives_every_force_its_own_acceleration_in_any_unit(
    metric,
):
    """
    N^T Omega_c f_c = a to 1e-9.

    That of the paper is N^T N a: it depends on the unit of length, and couples by tens of percent
    what eq. 31 has as k_s,i alpha*_i.
    """
    for scale in (1.0, 1000.0):
        decoupled = acceleration_of_contacts('decoupled', metric, scale)
        assert_allclose(decoupled, INPUTS, rtol=1e-9)
    paper = acceleration_of_contacts('paper', metric, 1.0)
    N = overlapping()
    coupling = N.T @ N
    assert_allclose(paper, coupling @ INPUTS, rtol=1e-9)
    alone = np.diag(coupling) * INPUTS
    assert (np.abs(paper / alone - 1.0) > 0.1).all()
    in_millimetres = acceleration_of_contacts('paper', metric, 1000.0)
    assert np.abs(in_millimetres / paper - 1.0).min() > 1.0


def test_paper_allocation_decouples_orthogonal_contacts():
    """With N^T N diagonal eq. 31 holds: the paper's own two contacts, arranged so."""
    normals = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    levers = np.array([[0.0, 0.0, 0.24], [0.0, -0.16, 0.19]])
    N = contact_normals(normals, levers)
    pressing = 6000.0 * N.T @ allocate_force(N, INPUTS[:2], 'paper')
    expected = stiffnesses(normals, levers) * INPUTS[:2]
    assert_allclose(pressing, expected, rtol=1e-12)


def test_placed_way_is_what_normals_and_axes_of_couples_take_of_a_way():
    """Of an edge along x on a level surface, and of a point on an oblique one."""
    down = np.array([0.0, 0.0, -1.0])
    oblique = np.array([0.0, 0.6, -0.8])
    force = np.append(down, [0.1, 0.2, 0.0])
    couple = np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0])
    way = np.array([0.3, 0.0, 0.5, 0.1, 0.2, 0.3])
    of_edge = project_on_contacts(way, np.array([force, couple]))
    assert_allclose(of_edge, [0.0, 0.0, 0.5, 0.0, 0.2, 0.0], atol=1e-15)
    of_point = project_on_contacts(way, np.append(oblique, np.zeros(3))[None])
    assert_allclose(of_point[:3], oblique * (oblique @ way[:3]), atol=1e-15)
    assert_array_equal(project_on_contacts(way, np.empty((0, 6))), 0.0)
