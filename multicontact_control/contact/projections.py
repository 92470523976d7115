"""
Contact coordinates and projections (P04 eqs 7-15, 27), as executed.

Contacts come and go, so matrices have a row per contact, which is zero for one that is left out;
neither Omega_f nor Omega_m is formed, only what they make of vectors.
"""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import (
    add_scaled_vector,
    cholesky,
    multiply_vector,
    solve_cholesky,
)
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.records import (
    Contact,
    MAX_COLUMNS,
    Record,
    record_dtype,
    Records,
)

# A normal counts as dependent when the others leave less than this share of its square: what is
# left of it multiplies the sensor's noise by more than 1000.
SMALLEST_NORMAL_PIVOT = 1e-6


class ContactProjection(Record, Protocol):
    """
    N and D of the active contacts, factorised; one.

    The first r rows are used, one for each contact, which are zero for one that is left out.
    """

    # N^T, D^T.
    rows: Annotated[Matrix, MAX_COLUMNS, 6]
    weighted_rows: Annotated[Matrix, MAX_COLUMNS, 6]

    factor: Annotated[Matrix, MAX_COLUMNS, MAX_COLUMNS]  # of N^T N
    weighted_factor: Annotated[Matrix, MAX_COLUMNS, MAX_COLUMNS]  # of N^T D

    # alpha* in `apply_force_law`; of `compose_acceleration` [m/s^2].
    alpha_star: Annotated[Vector, MAX_COLUMNS]
    beta: Annotated[Vector, MAX_COLUMNS]


CONTACT_PROJECTION = record_dtype(ContactProjection)


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
    projection: ContactProjection,
    count: int,
    f_t: Vector,
    f_c: Vector,
    acceleration: Vector,
) -> None:
    """
    Fill in Omega_m f_t* + Omega_c f_c* (P04 eq. 27), shape (6,) [m/s^2, rad/s^2].

    As Omega_m = 1 - Omega_c with Omega_c = D (N^T D)^-1 N^T, this is
    f_t* - D (N^T D)^-1 N^T (f_t* - f_c*). D = N gives the paper's projections (eqs 11-13),
    D = Lambda^-1 N the dynamically consistent ones, of `count` contacts in a record of
    `CONTACT_PROJECTION`.
    """
    rows = projection.rows[:count]
    weighted_rows = projection.weighted_rows[:count]
    beta = projection.beta[:count]
    for i in range(6):
        acceleration[i] = f_t[i] - f_c[i]
    multiply_vector(rows, acceleration, beta)
    solve_cholesky(projection.weighted_factor[:count, :count], beta)
    acceleration[:] = f_t
    for i in range(count):
        add_scaled_vector(acceleration, -beta[i], weighted_rows[i])
