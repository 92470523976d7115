"""Contact normal space, coordinates and projections for contacts that come and go, compiled."""

from __future__ import annotations

from multicontact_control.algebra import cholesky, multiply_transposed, solve_cholesky
from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.compiled import compiled

# A normal counts as dependent when the others leave less than this share of its square.
SMALLEST_PIVOT = 1e-12


@compiled
def normal_rows(normals: Matrix, points: Matrix, rotation: Matrix, rows: Matrix) -> None:
    """
    Fill in N^T: row i is the wrench that a unit force at contact i makes.

    N_i = [n_i; n_i x l_i] (P04 eq. 5), with the lever l_i = -R p_i from the contact point to
    the operational point.

    Parameters
    ----------
    normals
        Unit normals INTO the surfaces, world axes, shape (r, 3).
    points
        Contact points p_i in the operational frame, shape (r, 3) [m].
    rotation
        Axes R of the operational frame as columns, world axes, shape (3, 3).
    rows
        Filled, shape (r, 6).

    """
    for i in range(normals.shape[0]):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        lx = -(rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz)
        ly = -(rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz)
        lz = -(rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz)
        rows[i, 0], rows[i, 1], rows[i, 2] = nx, ny, nz
        rows[i, 3] = ny * lz - nz * ly
        rows[i, 4] = nz * lx - nx * lz
        rows[i, 5] = nx * ly - ny * lx


@compiled
def keep_active(rows: Matrix, active: Mask, kept: Matrix) -> None:
    """
    Fill in N^T with zeros for every contact that is not active.

    Parameters
    ----------
    rows, active
        N^T and which of its rows to keep, shapes (r, 6) and (r,).
    kept
        Filled, shape (r, 6).

    """
    for i in range(rows.shape[0]):
        for j in range(6):
            kept[i, j] = rows[i, j] if active[i] else 0.0


@compiled
def factorise_contacts(rows: Matrix, weighted_rows: Matrix, active: Mask, factor: Matrix) -> bool:
    """
    Factorise N^T D, with 1 on the diagonal of every contact that is not active.

    So the size stays the same whichever contacts are there, and the coordinate of one that is
    not there stays 0. D is N itself, or Lambda^-1 N.

    Parameters
    ----------
    rows, weighted_rows
        N^T and D^T, zero where not active, shape (r, 6).
    active
        Shape (r,).
    factor
        Filled with the Cholesky factor, shape (r, r).

    Returns
    -------
    bool
        Whether the active columns of N are independent.

    """
    count = rows.shape[0]
    for i in range(count):
        for j in range(i, count):
            total = 0.0
            for k in range(6):
                total += rows[i, k] * weighted_rows[j, k]
            factor[i, j] = total
        if not active[i]:
            factor[i, i] = 1.0
    return cholesky(factor, factor, SMALLEST_PIVOT)


@compiled
def coordinates(rows: Matrix, factor: Matrix, vector: Vector, alpha: Vector) -> None:
    """
    Fill in the contact coordinates alpha = (N^T N)^-1 N^T f (P04 eqs 2, 7).

    Parameters
    ----------
    rows, factor
        N^T, shape (r, 6), and the factor of N^T N, shape (r, r).
    vector
        Wrench or twist f, shape (6,).
    alpha
        Filled, shape (r,).

    """
    rates(rows, vector, alpha)
    solve_cholesky(factor, alpha)


@compiled
def rates(rows: Matrix, twist: Vector, speeds: Vector) -> None:
    """Fill in N^T theta, the speeds of the contact points along their normals, shape (r,)."""
    for i in range(rows.shape[0]):
        total = 0.0
        for k in range(6):
            total += rows[i, k] * twist[k]
        speeds[i] = total


@compiled
def compose_acceleration(
    rows: Matrix, weighted_rows: Matrix, weighted_factor: Matrix, f_t: Vector, f_c: Vector,
    acceleration: Vector,
) -> None:
    """
    Fill in Omega_m f_t* + Omega_c f_c* (P04 eq. 27).

    As Omega_m = 1 - Omega_c with Omega_c = D (N^T D)^-1 N^T, this is
    f_t* - D (N^T D)^-1 N^T (f_t* - f_c*). D = N gives the paper's projections (eqs 11-13),
    D = Lambda^-1 N the dynamically consistent ones.

    Parameters
    ----------
    rows, weighted_rows, weighted_factor
        N^T and D^T, shape (r, 6), and the factor of N^T D, shape (r, r).
    f_t, f_c
        Accelerations of the motion and the force law, shape (6,).
    acceleration
        Filled, shape (6,).

    """
    count = rows.shape[0]
    for k in range(6):
        acceleration[k] = f_t[k] - f_c[k]
    beta = rows[:, 0].copy()
    rates(rows, acceleration, beta)
    solve_cholesky(weighted_factor, beta)
    for k in range(6):
        total = f_t[k]
        for i in range(count):
            total -= weighted_rows[i, k] * beta[i]
        acceleration[k] = total


@compiled
def allocate(
    rows: Matrix, factor: Matrix, alpha_star: Vector, decoupled: bool, f_c: Vector,
) -> None:
    """
    Fill in the acceleration that serves the force loops.

    N (N^T N)^-1 alpha* if `decoupled`, else N alpha* (P04 eq. 30).

    Parameters
    ----------
    rows, factor
        N^T, shape (r, 6), and the factor of N^T N, shape (r, r).
    alpha_star
        Inputs of the force loops, overwritten, shape (r,) [m/s^2].
    decoupled
        Which of the two.
    f_c
        Filled, shape (6,) [m/s^2, rad/s^2].

    """
    if decoupled:
        solve_cholesky(factor, alpha_star)
    multiply_transposed(rows, alpha_star, f_c)
