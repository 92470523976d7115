"""Projections onto the force and the motion space, and the force allocation (P04 eqs 7-15, 30)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from multicontact_control.arrays import Matrix, Vector
import numpy as np

Allocation = Literal['decoupled', 'paper']


@dataclass(frozen=True, slots=True)
class Projections:
    """
    The pair that splits wrenches and accelerations.

    Attributes
    ----------
    Omega_f
        Onto the contact wrenches, shape (6, 6) (P04 eq. 9).
    Omega_m
        Onto the free motions, shape (6, 6) (P04 eq. 10).

    """

    Omega_f: Matrix
    Omega_m: Matrix

    @property
    def Omega_c(self) -> Matrix:
        """Complement 1 - Omega_m on motions; Omega_f itself in the Euclidean metric (eq. 13)."""
        complement: Matrix = self.Omega_f.T
        return complement


def euclidean_projections(N: Matrix) -> Projections:
    """
    Return the paper's projections.

    Omega_f = N (N^T N)^-1 N^T, Omega_m = 1 - Omega_f (P04 eqs 11-13, N' = T and T' = N).

    Parameters
    ----------
    N
        Contact normal space, shape (m, r), independent columns.

    """
    size = N.shape[0]
    if N.shape[1] == 0:
        return Projections(np.zeros((size, size)), np.eye(size))
    Omega_f = N @ np.linalg.solve(N.T @ N, N.T)
    return Projections(Omega_f, np.eye(size) - Omega_f)


def inertia_projections(N: Matrix, Lambda: Matrix) -> Projections:
    """
    Return the dynamically consistent projections, which do not depend on the unit of length.

    Omega_f = N (N^T Lambda^-1 N)^-1 N^T Lambda^-1, Omega_m = 1 - Omega_f^T: the general form of
    eqs 9-12 with T' = Lambda^-1 N and N' = Lambda T.

    Parameters
    ----------
    N
        Contact normal space, shape (m, r), independent columns.
    Lambda
        Task inertia, shape (m, m).

    """
    size = N.shape[0]
    if N.shape[1] == 0:
        return Projections(np.zeros((size, size)), np.eye(size))
    mobility_N = np.linalg.solve(Lambda, N)  # Lambda^-1 N
    Omega_f = N @ np.linalg.solve(N.T @ mobility_N, mobility_N.T)
    return Projections(Omega_f, np.eye(size) - Omega_f.T)


def general_projections(N: Matrix, T: Matrix, N_prime: Matrix, T_prime: Matrix) -> Projections:
    """
    Return the projections for any choice of complements.

    f = N alpha_1 + N' alpha_2, theta = T beta_1 + T' beta_2 (P04 eqs 7-8) with N^T T = 0 and
    N'^T T' = 0: Omega_f = N (T'^T N)^-1 T'^T, Omega_m = T (N'^T T)^-1 N'^T.

    Parameters
    ----------
    N, T_prime
        Shape (m, r).
    T, N_prime
        Shape (m, m - r).

    """
    return Projections(
        N @ np.linalg.solve(T_prime.T @ N, T_prime.T),
        T @ np.linalg.solve(N_prime.T @ T, N_prime.T))


def allocate_force(N: Matrix, alpha_star: Vector, allocation: Allocation) -> Vector:
    """
    Return the acceleration of the operational point that serves the contacts' force loops.

    `paper`: f_c* = N alpha* (P04 eq. 30). The contact points then accelerate by N^T N alpha*,
    which couples the loops unless N^T N is diagonal. `decoupled`: f_c* = N (N^T N)^-1 alpha*, so
    that contact point i accelerates by alpha*_i whatever the geometry.

    Parameters
    ----------
    N
        Contact normal space, shape (6, r).
    alpha_star
        Inputs of the force loops, shape (r,) [m/s^2].
    allocation
        Which of the two.

    Returns
    -------
    Vector
        f_c*, shape (6,) [m/s^2, rad/s^2].

    """
    if N.shape[1] == 0:
        return np.zeros(N.shape[0])
    if allocation == 'paper':
        return N @ alpha_star
    return N @ np.linalg.solve(N.T @ N, alpha_star)


def contact_rates(N: Matrix, twist: Vector, allocation: Allocation) -> Vector:
    """
    Return the rates theta_c that the force loops' damping K_2 acts on.

    They are the rates along the coordinates the allocation drives: N^+ theta for `paper` (where
    theta_c,i multiplies N_i, P04 eq. 16), N^T theta, the speed of the contact point along its
    normal, for `decoupled`.

    Parameters
    ----------
    N
        Contact normal space, shape (6, r).
    twist
        Twist of the operational point, shape (6,) [m/s, rad/s].
    allocation
        As for `allocate_force`.

    Returns
    -------
    Vector
        Shape (r,) [m/s].

    """
    rates: Vector = N.T @ twist
    if allocation == 'paper' and N.shape[1]:
        rates = np.asarray(np.linalg.solve(N.T @ N, rates), dtype=float)
    return rates
