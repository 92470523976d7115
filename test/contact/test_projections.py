"""
Normals, projections and allocation against the paper (P04 eqs 2-22, 30-31).

The compiled functions never form the matrices: here they are made column by column.
"""

import equations
from equations import free_motions, operational_stiffness
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
from multicontact_control.force.plant import make_delayed_plant, place_poles
from multicontact_control.records import CONTACT, LAW
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

INPUTS = np.array([0.7, -0.4, 1.1])  # a_i [m/s^2]


def contact_normals(normals_world, levers_world):
    """Return N of contacts a lever away from an operational point with the world's axes."""
    contacts = np.zeros(len(normals_world), dtype=CONTACT)
    contacts['normal'], contacts['config']['point'] = normals_world, -levers_world
    return normal_space(contacts, np.eye(3))


def factorised(N, Lambda=None):
    contacts = np.zeros(N.shape[1], dtype=CONTACT)
    contacts['N'], contacts['answer']['active'] = N.T, True
    rows = np.ascontiguousarray(N.T)
    weighted = (
        rows if Lambda is None else np.ascontiguousarray(np.linalg.solve(Lambda, N).T)
    )
    factor = np.empty((len(rows), len(rows)))
    assert factorise_contacts(contacts, False, rows, weighted, factor)
    return rows, weighted, factor


def factorised_record(N, Lambda=None):
    """Return a record of `CONTACT_PROJECTION`, whose factor of N^T N is that of N^T D, too."""
    count = N.shape[1]
    projection = np.zeros(1, dtype=CONTACT_PROJECTION)[0]
    rows, weighted, factor = factorised(N, Lambda)
    projection['rows'][:count] = rows
    projection['weighted_rows'][:count] = weighted
    for name in ('factor', 'weighted_factor'):
        projection[name][:count, :count] = factor
    return projection


def projections(N, Lambda=None):
    """Return Omega_f, as the dual of Omega_c, and Omega_m."""
    Omega_m = np.empty((6, 6))
    Omega_c = np.empty((6, 6))
    column = np.empty(6)
    for k, unit in enumerate(np.eye(6)):
        for matrix, f_t, f_c in (
            (Omega_m, unit, np.zeros(6)),
            (Omega_c, np.zeros(6), unit),
        ):
            compose_acceleration(
                factorised_record(N, Lambda), N.shape[1], f_t, f_c, column
            )
            matrix[:, k] = column
    assert_allclose(Omega_c, np.eye(6) - Omega_m, atol=1e-12)
    return Omega_c.T, Omega_m


def allocate_force(N, alpha_star, allocation):
    law = np.zeros(1, dtype=LAW)
    f_c = np.empty(6)
    law['decoupled'] = allocation == 'decoupled'
    contacts = np.zeros(N.shape[1], dtype=CONTACT)
    apply_force_law(
        law[0],
        np.zeros(6),
        contacts,
        factorised_record(N),
        np.array(alpha_star),
        f_c,
    )
    return f_c


def coordinate_inputs(N, inputs):
    """Return alpha* of the coordinates for u of the contact points."""
    alpha_star = np.array(inputs)
    convert_to_coordinates(np.ascontiguousarray(N.T), alpha_star)
    return alpha_star


def contact_rates(N, twist, allocation):
    rows, _, factor = factorised(N)
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
    random = np.random.default_rng(seed)
    normals, levers = random.standard_normal((2, count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert_allclose(
        contact_normals(normals, levers),
        equations.contact_normals(normals, levers),
        atol=1e-14,
    )


def test_operational_stiffness_of_the_planar_example():
    """k_s = k_env (1 + l^2 sin^2 gamma) (P04 eq. 21): the loop commands so much less."""
    l, gamma = 0.7, 0.6
    normal = np.array([0.0, 1.0, 0.0])
    lever = l * np.array([np.sin(gamma), np.cos(gamma), 0.0])
    expected = 6000.0 * (1.0 + (l * np.sin(gamma)) ** 2)
    assert operational_stiffness(6000.0, normal, lever) == pytest.approx(
        expected, rel=1e-14
    )
    alpha_star = coordinate_inputs(contact_normals(normal[None], lever[None]), [1.0])
    assert 6000.0 / alpha_star[0] == pytest.approx(expected, rel=1e-14)


def test_force_loop_for_k_s_commands_the_share_k_env_over_k_s():
    """Of what the loop for k_env does (eq. 36), which has the inputs under way likewise."""
    ratio, h = 1.7, 0.002
    k_env, k_s = (
        place_poles(make_delayed_plant(k, 20.0, 0.006, h), h, time_constant=0.02).L
        for k in (6000.0, ratio * 6000.0)
    )
    assert_allclose(k_s[:2], k_env[:2] / ratio, rtol=1e-9)
    assert_allclose(k_s[2:], k_env[2:], rtol=1e-9)


def test_paper_allocation_of_oblique_contacts_is_that_of_the_equations():
    """N alpha* for k_s couples them: alpha_ddot_i = k_env sum_j N_i^T N_j alpha*_j."""
    random = np.random.default_rng(3)
    normals, levers = random.standard_normal((2, 3, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    N = equations.contact_normals(normals, levers)
    assert np.abs(np.triu(N.T @ N, 1)).max() > 0.3
    k_s = np.array(
        [operational_stiffness(6000.0, *pair) for pair in zip(normals, levers)]
    )
    alpha_star = INPUTS * 6000.0 / k_s
    f_c = allocate_force(N, coordinate_inputs(N, INPUTS), 'paper')
    assert_allclose(f_c, equations.allocate_force(N, alpha_star, 'paper'), rtol=1e-12)
    assert_allclose(6000.0 * N.T @ f_c, 6000.0 * N.T @ N @ alpha_star, rtol=1e-12)


def test_euclidean_projections_of_the_planar_example():
    """With l = sqrt(2), gamma = 45 deg: N = [0 1 -1]^T, Omega_f and Omega_m (P04 eqs 18, 22)."""
    N = contact_normals(np.array([[0.0, 1.0, 0.0]]), np.array([[1.0, 1.0, 0.0]]))
    assert_allclose(N[[0, 1, 5], 0], [0.0, 1.0, -1.0], atol=1e-15)
    Omega_f, Omega_m = projections(N)
    plane = np.ix_([0, 1, 5], [0, 1, 5])  # x, y and the rotation about z
    assert_allclose(
        Omega_f[plane], [[0, 0, 0], [0, 0.5, -0.5], [0, -0.5, 0.5]], atol=1e-15
    )
    assert_allclose(
        Omega_m[plane], [[1, 0, 0], [0, 0.5, 0.5], [0, 0.5, 0.5]], atol=1e-15
    )


def test_projections_are_those_of_the_equations_in_full_matrices():
    N = overlapping()
    Lambda = task_inertia('inertia')
    for result, expected in (
        (projections(N), equations.euclidean_projections(N)),
        (projections(N, Lambda), equations.inertia_projections(N, Lambda)),
    ):
        assert_allclose(result, expected, atol=1e-11)


def test_contact_coordinates_are_the_forces_for_any_free_part():
    """N^+ (N alpha + T beta) = alpha (P04 eq. 7); rates invert either allocation."""
    N = overlapping()
    random = np.random.default_rng(0)
    wrench = N @ INPUTS + free_motions(N) @ random.standard_normal(3)
    assert_allclose(contact_rates(N, wrench, 'paper'), INPUTS, atol=1e-12)
    for allocation in ('paper', 'decoupled'):
        assert_allclose(
            contact_rates(N, allocate_force(N, INPUTS, allocation), allocation),
            INPUTS,
            atol=1e-12,
        )


@pytest.mark.parametrize('metric', ['euclidean', 'inertia'])
def test_decoupled_allocation_gives_every_force_its_own_acceleration_in_any_unit(
    metric,
):
    """
    N^T Omega_c f_c = a to 1e-9.

    That of the paper is N^T N a: it depends on the unit of length, and couples by tens of percent
    what eq. 31 has as k_s,i alpha*_i.
    """
    accelerations = {}
    for scale in (1.0, 1000.0):
        N = overlapping(scale)
        Omega_c = projections(N, task_inertia(metric, scale))[0].T
        for allocation in ('decoupled', 'paper'):
            f_c = allocate_force(N, scale * INPUTS, allocation)
            accelerations[allocation, scale] = (
                N.T @ Omega_c @ f_c / scale
            )  # back in m/s^2
        assert_allclose(accelerations['decoupled', scale], INPUTS, rtol=1e-9)
    paper = accelerations['paper', 1.0]
    N = overlapping()
    assert_allclose(paper, N.T @ N @ INPUTS, rtol=1e-9)
    assert (np.abs(paper / (np.diag(N.T @ N) * INPUTS) - 1.0) > 0.1).all()
    assert np.abs(accelerations['paper', 1000.0] / paper - 1.0).min() > 1.0


def test_paper_allocation_decouples_orthogonal_contacts():
    """With N^T N diagonal eq. 31 holds: the paper's own two contacts, arranged so."""
    normals = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    levers = np.array([[0.0, 0.0, 0.24], [0.0, -0.16, 0.19]])
    N = contact_normals(normals, levers)
    k_s = [
        operational_stiffness(6000.0, normal, l) for normal, l in zip(normals, levers)
    ]
    assert_allclose(
        6000.0 * N.T @ allocate_force(N, INPUTS[:2], 'paper'),
        k_s * INPUTS[:2],
        rtol=1e-12,
    )


def test_placed_way_is_what_normals_and_axes_of_couples_take_of_a_way():
    """Of an edge along x on a level surface, and of a point on an oblique one."""
    down = np.array([0.0, 0.0, -1.0])
    oblique = np.array([0.0, 0.6, -0.8])
    force = np.append(down, [0.1, 0.2, 0.0])
    couple = np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0])
    way = np.array([0.3, 0.0, 0.5, 0.1, 0.2, 0.3])
    assert_allclose(
        project_on_contacts(way, np.array([force, couple])),
        [0.0, 0.0, 0.5, 0.0, 0.2, 0.0],
        atol=1e-15,
    )
    assert_allclose(
        project_on_contacts(way, np.append(oblique, np.zeros(3))[None])[:3],
        oblique * (oblique @ way[:3]),
        atol=1e-15,
    )
    assert_array_equal(project_on_contacts(way, np.empty((0, 6))), 0.0)
