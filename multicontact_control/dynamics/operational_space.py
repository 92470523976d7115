"""The arm's dynamics at the operational point (P04 eqs 23-25)."""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.dynamics.robot import RobotState
from multicontact_control.errors import SingularTaskError
import numpy as np

MAX_CONDITION = 1e8


@dataclass(frozen=True, slots=True)
class OperationalSpace:
    """
    Quantities of Lambda dtheta/dt + mu + p + f_c = F (P04 eq. 23).

    Attributes
    ----------
    Lambda
        Inertia at the operational point, shape (6, 6) [kg, kg m, kg m^2].
    J_bar
        Dynamically consistent inverse M^-1 J^T Lambda, shape (n, 6).
    mu
        Coriolis and centripetal wrench, shape (6,) [N, N m].
    p
        Gravity wrench, shape (6,) [N, N m].
    damped
        Whether Lambda is damped, near a singularity: J_bar is not a full inverse of J then.

    """

    Lambda: Matrix
    J_bar: Matrix
    mu: Vector
    p: Vector
    damped: bool = False


def mobility_damping(smallest: float, singular_mobility: float) -> float:
    """
    Return what to add to the eigenvalues of J M^-1 J^T near a singularity.

    d = e_0 / 2 (1 - e / e_0)^2 for a smallest eigenvalue e below e_0, else 0. Lambda then has
    no eigenvalue above 2 / e_0, changes smoothly, and is exact away from singularities. This is
    damped least squares in the metric of M: in the direction that the arm is losing it does
    less than asked, and no torque grows without bound.

    Parameters
    ----------
    smallest, singular_mobility
        e and e_0 [1/kg]; e_0 = 0 for no damping.

    """
    if singular_mobility <= 0.0 or smallest >= singular_mobility:
        return 0.0
    return 0.5 * singular_mobility * (1.0 - smallest / singular_mobility) ** 2


def task_inertia(
    mass_matrix: Matrix, jacobian: Matrix, *, max_condition: float = MAX_CONDITION,
    singular_mobility: float = 0.0,
) -> Matrix:
    """
    Return the inertia felt at a task frame.

    Lambda = (J M^-1 J^T)^-1 (P04 eq. 23).

    Parameters
    ----------
    mass_matrix
        Joint inertia M, shape (n, n), symmetric positive definite [kg m^2].
    jacobian
        Task Jacobian J, shape (m, n), world axes, linear rows first.
    max_condition
        Largest accepted condition number of J M^-1 J^T.
    singular_mobility
        See `mobility_damping`.

    Returns
    -------
    Matrix
        Lambda, shape (m, m).

    Raises
    ------
    ShapeError
        If `jacobian` does not have n columns.
    SingularTaskError
        If J M^-1 J^T is conditioned worse than `max_condition`.

    """
    require_shape('jacobian', jacobian, (jacobian.shape[0], mass_matrix.shape[0]))
    mobility = jacobian @ np.linalg.solve(mass_matrix, jacobian.T)
    eigenvalues, vectors = np.linalg.eigh(0.5 * (mobility + mobility.T))
    eigenvalues = eigenvalues + mobility_damping(float(eigenvalues[0]), singular_mobility)
    if eigenvalues[0] * max_condition <= eigenvalues[-1]:
        raise SingularTaskError(
            f'J M^-1 J^T: expected a condition number below {max_condition:g}, found '
            f'eigenvalues from {eigenvalues[0]:.3g} to {eigenvalues[-1]:.3g}')
    inertia: Matrix = (vectors / eigenvalues) @ vectors.T
    return inertia


def operational_space(
    state: RobotState, *, singular_mobility: float = 0.0,
) -> OperationalSpace:
    """
    Express the arm's dynamics at the operational point.

    mu = J_bar^T C v - Lambda dJ/dt v, p = J_bar^T g (P04 eq. 23).

    Raises
    ------
    SingularTaskError
        If the arm cannot accelerate the operational point in every direction.

    """
    Lambda = task_inertia(
        state.mass_matrix, state.jacobian, singular_mobility=singular_mobility)
    J_bar = np.asarray(
        np.linalg.solve(state.mass_matrix, state.jacobian.T @ Lambda), dtype=float)
    mu = J_bar.T @ state.coriolis - Lambda @ state.jacobian_drift
    damped = singular_mobility > 0.0 and bool(
        np.abs(state.jacobian @ J_bar - np.eye(6)).max() > 1e-9)
    return OperationalSpace(
        Lambda=Lambda, J_bar=J_bar, mu=mu, p=J_bar.T @ state.gravity, damped=damped)


def joint_torque(
    wrench_world: Vector, state: RobotState, space: OperationalSpace, *,
    nullspace_damping: float = 0.0,
) -> Vector:
    """
    Return the joint torque that makes a wrench at the operational point.

    Gamma = J^T F (P04 sec. 3). With more than six joints the motion that the operational point
    does not see, or near a singularity hardly, is gravity compensated and damped:
    Gamma += (1 - J^T J_bar^T)(C v + g - d M v).

    Parameters
    ----------
    wrench_world
        F, shape (6,) [N, N m].
    state, space
        The arm at this instant.
    nullspace_damping
        d [1/s].

    Returns
    -------
    Vector
        Gamma, shape (n,) [N m].

    """
    torque: Vector = state.jacobian.T @ wrench_world
    if state.mass_matrix.shape[0] > 6 or space.damped:
        free = state.coriolis + state.gravity - nullspace_damping * (
            state.mass_matrix @ state.velocity)
        torque += free - state.jacobian.T @ (space.J_bar.T @ free)
    return torque
