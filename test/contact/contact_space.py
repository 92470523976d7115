"""What the compiled contact functions do, as the matrices that they never form."""

from equations import Projections
from multicontact_control.algebra import multiply, solve_cholesky
from multicontact_control.contact import projections as executed
from multicontact_control.contact.geometry import normal_space
from multicontact_control.control.law import force_law
from multicontact_control.records import CONTACT, LAW
import numpy as np


def contact_normals(normals_world, levers_world):
    """Return N of contacts a lever away from an operational point with the world's axes."""
    contacts = np.zeros(len(normals_world), dtype=CONTACT)
    contacts['normal'], contacts['config']['point'] = normals_world, -levers_world
    return normal_space(contacts, np.eye(3))


def _factorised(N, Lambda=None):
    contacts = np.zeros(N.shape[1], dtype=CONTACT)
    contacts['N'], contacts['answer']['active'] = N.T, True
    rows = np.empty((N.shape[1], 6))
    rows[:] = contacts['N']
    weighted = rows if Lambda is None else np.ascontiguousarray(
        np.linalg.solve(Lambda, rows.T).T)
    factor = np.empty((len(rows), len(rows)))
    assert executed.factorise_contacts(contacts, False, rows, weighted, factor)
    return rows, weighted, factor


def projections(N, Lambda=None):
    """Return Omega_m, and Omega_f as the dual of Omega_c, from what is made of unit vectors."""
    rows, weighted, factor = _factorised(N, Lambda)
    Omega_m, Omega_c = np.empty((6, 6)), np.empty((6, 6))
    column = np.empty(6)
    for k, unit in enumerate(np.eye(6)):
        for matrix, f_t, f_c in ((Omega_m, unit, np.zeros(6)), (Omega_c, np.zeros(6), unit)):
            executed.compose_acceleration(rows, weighted, factor, f_t, f_c, column)
            matrix[:, k] = column
    np.testing.assert_allclose(Omega_c, np.eye(6) - Omega_m, atol=1e-12)
    return Projections(Omega_c.T, Omega_m)


def allocate_force(N, alpha_star, allocation):
    rows, _, factor = _factorised(N)
    law, f_c = np.zeros(1, dtype=LAW), np.empty(6)
    law['decoupled'] = allocation == 'decoupled'
    contacts = np.zeros(len(rows), dtype=CONTACT)
    force_law(law[0], rows, factor, np.zeros(6), contacts, np.array(alpha_star), f_c)
    return f_c


def contact_rates(N, twist, allocation):
    rows, _, factor = _factorised(N)
    rates = np.empty(len(rows))
    multiply(rows, twist, rates)
    if allocation == 'paper':
        solve_cholesky(factor, rates)
    return rates


def contact_coordinates(N, vector):
    return contact_rates(N, vector, 'paper')
