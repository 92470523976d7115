"""Contact normals and lever arms as the matrices N and T (P04 eqs 1-6, 17)."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.errors import ContactGeometryError
import numpy as np

MIN_INDEPENDENCE = 1e-6
MAX_CONTACTS = 6  # as many as a wrench has components


def contact_normals(normals_world: Matrix, levers_world: Matrix) -> Matrix:
    """
    Return N, whose columns are the wrenches that unit contact forces make.

    N_i = [n_i; n_i x l_i] (P04 eq. 5).

    Parameters
    ----------
    normals_world
        Unit normals INTO the surfaces, shape (r, 3).
    levers_world
        Vectors from each contact point to the operational point, shape (r, 3) [m].

    Returns
    -------
    Matrix
        N at the operational point, world axes, shape (6, r).

    Raises
    ------
    ShapeError
        If the two do not both have shape (r, 3).

    """
    count = normals_world.shape[0]
    require_shape('normals_world', normals_world, (count, 3))
    require_shape('levers_world', levers_world, (count, 3))
    N = np.empty((6, count))
    N[:3] = normals_world.T
    nx, ny, nz = normals_world.T
    lx, ly, lz = levers_world.T
    N[3] = ny * lz - nz * ly  # np.cross costs ten times these three lines
    N[4] = nz * lx - nx * lz
    N[5] = nx * ly - ny * lx
    return N


def free_motions(N: Matrix) -> Matrix:
    """
    Return T, an orthonormal basis of the motions that move no contact along its normal.

    N^T T = 0 (P04 eqs 4, 6).

    Parameters
    ----------
    N
        Contact normal space, shape (m, r).

    Returns
    -------
    Matrix
        T, shape (m, m - r).

    Raises
    ------
    ContactGeometryError
        If the columns of N are not independent.

    """
    rows, columns = N.shape
    if columns == 0:
        return np.eye(rows)
    U, singular, _ = np.linalg.svd(N)
    if columns > rows or singular[-1] < MIN_INDEPENDENCE * singular[0]:
        raise ContactGeometryError(
            f'N: expected {columns} independent columns, found singular values '
            f'{np.array2string(singular, precision=3)}')
    T: Matrix = U[:, columns:]
    return T


def operational_stiffness(k_env: float, normal_world: Vector, lever_world: Vector) -> float:
    """
    Return the stiffness of one contact as felt at the operational point.

    k_s = k_env (1 + |l x n|^2) (P04 eq. 17).

    Parameters
    ----------
    k_env
        Stiffness at the contact point [N/m].
    normal_world, lever_world
        Unit normal and vector from the contact point to the operational point [m], shape (3,).

    Returns
    -------
    float
        k_s [N/m] for coordinates along N_i. The 1 in it is a number, |l x n| is in metres: k_s
        depends on the unit of length, as N_i itself does.

    """
    moment = np.cross(lever_world, normal_world)
    return float(k_env * (1.0 + moment @ moment))


def contact_coordinates(N: Matrix, wrench_or_twist: Vector) -> Vector:
    """
    Return the coordinates of the contact part of a wrench or twist.

    alpha = N^+ f = (N^T N)^-1 N^T f (P04 eqs 2, 7 with N' = T).

    Parameters
    ----------
    N
        Contact normal space, shape (6, r).
    wrench_or_twist
        Shape (6,).

    Returns
    -------
    Vector
        Shape (r,): [N] for a wrench.

    """
    if N.shape[1] == 0:
        return np.zeros(0)
    return np.asarray(np.linalg.solve(N.T @ N, N.T @ wrench_or_twist), dtype=float)
