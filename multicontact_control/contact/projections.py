"""
Contact coordinates and projections (P04 eqs 7-15, 27), as executed.

Contacts come and go, so matrices have a row per contact, which is zero for one that is left out;
neither Omega_f nor Omega_m is formed, only what they make of vectors.
"""

from __future__ import annotations

from multicontact_control.algebra import (
    add_scaled_vector,
    cholesky,
    multiply_vector,
    solve_cholesky,
)
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.records import Contact, Records

# A normal counts as dependent when the others leave less than this share of its square: what is
# left of it multiplies the sensor's noise by more than 1000.
SMALLEST_NORMAL_PIVOT = 1e-6


@compiled
def factorise_contacts(
    contacts: Records[Contact],
    everyone: bool,
    rows: Matrix,
    weighted_rows: Matrix,
    factor: Matrix,
) -> bool:
    """
    Factorise N^T D; return whether the active columns of N are independent.

    D is N itself, or Lambda^-1 N. All contacts count, or those that are active; every one that is
    left out has 1 on the diagonal, so that the size stays the same, and its coordinate 0. `rows`
    and `weighted_rows` are N^T and D^T, zero for those left out, shape (r, 6); `factor`, shape
    (r, r), is filled with the Cholesky factor.
    """
    count = rows.shape[0]
    for i in range(count):
        for j in range(i, count):
            total = 0.0
            for k in range(6):
                total += rows[i, k] * weighted_rows[j, k]
            factor[i, j] = total
        if not (everyone or contacts[i].answer.active):
            factor[i, i] = 1.0
    return cholesky(factor, factor, SMALLEST_NORMAL_PIVOT)


@compiled
def compose_acceleration(
    rows: Matrix,
    weighted_rows: Matrix,
    weighted_factor: Matrix,
    f_t: Vector,
    f_c: Vector,
    beta: Vector,
    acceleration: Vector,
) -> None:
    """
    Fill in Omega_m f_t* + Omega_c f_c* (P04 eq. 27).

    As Omega_m = 1 - Omega_c with Omega_c = D (N^T D)^-1 N^T, this is
    f_t* - D (N^T D)^-1 N^T (f_t* - f_c*). D = N gives the paper's projections (eqs 11-13),
    D = Lambda^-1 N the dynamically consistent ones. `rows` and `weighted_rows` are N^T and D^T,
    shape (r, 6), `weighted_factor` is that of N^T D; `beta`, shape (r,), is overwritten.
    """
    for i in range(6):
        acceleration[i] = f_t[i] - f_c[i]
    multiply_vector(rows, acceleration, beta)
    solve_cholesky(weighted_factor, beta)
    acceleration[:] = f_t
    for i in range(rows.shape[0]):
        add_scaled_vector(acceleration, -beta[i], weighted_rows[i])
