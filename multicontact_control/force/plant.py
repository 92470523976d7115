"""The delayed plant of one force loop and its state feedback (P04 eqs 32, 33, 36)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import MAX_DELAY_PERIODS
from multicontact_control.errors import ConfigError
import numpy as np
from scipy.linalg import expm

SMALL_EXPONENT = 0.1


@dataclass(frozen=True, slots=True)
class DelayedPlant:
    """
    x_k = Phi x_{k-1} + Gamma u_{k-1}, y_k = alpha_k (P04 eq. 33).

    x = [alpha, dalpha/dt, v_{k-d}, ..., v_{k-1}], shape (2 + d,), with the inputs v = u + p under
    way.
    """

    Phi: Matrix
    Gamma: Vector


def make_delayed_plant(
    stiffness: float,
    damping_rate: float,
    input_delay: float,
    period: float,
) -> DelayedPlant:
    """
    Discretise G(s) = k e^(-s T_d) / (s (s + K_2)) with a zero-order hold (P04 eqs 32-33).

    Parameters
    ----------
    stiffness, damping_rate
        k [N/m] and K_2 [1/s].
    input_delay, period
        T_d, at most 10 periods, and h [s].

    Raises
    ------
    ConfigError
        If the delay is out of its range.

    """
    if not 0.0 <= input_delay <= MAX_DELAY_PERIODS * period * (1.0 + 1e-9):
        raise ConfigError(
            'input_delay',
            f'0 to {MAX_DELAY_PERIODS} periods ({MAX_DELAY_PERIODS * period:g} s)',
            f'{input_delay:g} s',
        )
    A = np.array([[0.0, 1.0], [0.0, -damping_rate]])
    B = np.array([[0.0], [stiffness]])
    Phi, Gamma = discretise_delayed_input(A, B, input_delay, period)
    return DelayedPlant(Phi, Gamma[:, 0])


def discretise_delayed_input(
    A: Matrix,
    B: Matrix,
    input_delay: float,
    period: float,
) -> tuple[Matrix, Matrix]:
    """
    Discretise dx/dt = A x + B u(t - T_d), of shapes (n, n) and (n, r), with a zero-order hold.

    With T_d = (d - 1) h + tau', 0 < tau' <= h, the input u_{k-d} acts for tau' of a period and
    u_{k-d+1} for the rest of it. Returns Phi, shape (n + d r, n + d r), and Gamma, shape
    (n + d r, r), of the state [x, u_{k-d}, ..., u_{k-1}].
    """
    n, r = B.shape
    # The tolerance keeps 0.006 / 0.002 at three periods in spite of rounding.
    d = math.ceil(input_delay / period - 1e-9)
    late = 0.0  # tau'
    if d:
        late = input_delay - (d - 1) * period
    late = min(max(late, 0.0), period)
    Phi_h, _ = _zero_order_hold(A, B, period)
    after, recent = _zero_order_hold(A, B, period - late)
    _, early = _zero_order_hold(A, B, late)
    # All states and the new input, one after the other: what is under way moves up.
    moved = np.eye(n + d * r, n + (d + 1) * r, k=r)
    moved[:n] = 0.0
    moved[:n, :n] = Phi_h
    moved[:n, n : n + r] = after @ early
    second = n + min(1, d) * r
    moved[:n, second : second + r] += recent
    return moved[:, : n + d * r], moved[:, n + d * r :]


def _zero_order_hold(A: Matrix, B: Matrix, duration: float) -> tuple[Matrix, Matrix]:
    """Return exp(A t) and the integral of exp(A s) B over s from 0 to t."""
    n, r = B.shape
    if _is_damped_mass(A, B):
        return _damped_hold(float(B[1, 0]), -float(A[1, 1]), duration)
    augmented = np.zeros((n + r, n + r))
    augmented[:n] = np.hstack([A, B])
    exponential = expm(augmented * duration)
    return exponential[:n, :n], exponential[:n, n:]


def _is_damped_mass(A: Matrix, B: Matrix) -> bool:
    """Return whether A = [[0, 1], [0, -K_2]] and B = [[0], [k]]."""
    if B.shape != (2, 1) or B[0, 0] != 0.0:
        return False
    return A[0].tolist() == [0.0, 1.0] and bool(A[1, 0] == 0.0)


def _damped_hold(
    stiffness: float,
    damping_rate: float,
    duration: float,
) -> tuple[Matrix, Matrix]:
    """Return what `_zero_order_hold` does for a damped mass, in closed form."""
    # A general matrix exponential may keep a control tick waiting for the threads of its BLAS.
    x = damping_rate * duration
    first = 1.0  # (1 - e^-x) / x
    if x:
        first = -math.expm1(-x) / x
    if x > SMALL_EXPONENT:
        second = (1.0 - first) / x
    else:  # by its series, where that would cancel
        second = sum((-x) ** n / math.factorial(n + 2) for n in range(10))
    way_of_speed = duration * first
    speed_kept = math.exp(-x)
    Phi = np.array([[1.0, way_of_speed], [0.0, speed_kept]])
    Gamma = stiffness * duration * np.array([[duration * second], [first]])
    return Phi, Gamma


def place_eigenvalues(Phi: Matrix, Gamma: Vector, poles: Sequence[float]) -> Vector:
    """
    Return the feedback L, shape (n,), that places the eigenvalues of Phi - Gamma L.

    L = [0 ... 0 1] [Gamma, Phi Gamma, ...]^-1 phi_c(Phi) for n real poles (Ackermann's formula,
    P04 eq. 36).
    """
    n = Phi.shape[0]
    # Balanced first: alpha is some 1e4 times its inputs, and Ackermann squares that again.
    scale = np.maximum(np.abs(Gamma), np.abs(Phi).max(axis=1))
    scale[scale == 0.0] = 1.0
    Phi_s = Phi / scale[:, None] * scale
    columns = [Gamma / scale]
    for _ in range(n - 1):
        columns.append(Phi_s @ columns[-1])
    polynomial = np.eye(n)
    for pole in sorted(poles, reverse=True):
        polynomial = polynomial @ (Phi_s - pole * np.eye(n))
    last = np.zeros(n)
    last[-1] = 1.0
    last_row = np.linalg.solve(np.vstack(columns), last)  # of the inverse
    feedback: Vector = last_row @ polynomial / scale
    return feedback


@dataclass(frozen=True, slots=True)
class ForceLoop:
    """
    A plant with its state feedback u = r - L x - p, r = L_1 f_des, L of shape (2 + d,).

    L_1 gives the loop a DC gain of 1 from desired to real force (P04 eq. 36).
    """

    plant: DelayedPlant
    L: Vector

    @property
    def closed_loop(self) -> Matrix:
        """Phi_r - Gamma_r L_r, shape (2 + d, 2 + d)."""
        matrix: Matrix = self.plant.Phi - np.outer(self.plant.Gamma, self.L)
        return matrix


def place_poles(
    plant: DelayedPlant,
    period: float,
    *,
    time_constant: float,
    second_pole_ratio: float = 1.0,
) -> ForceLoop:
    """
    Place poles at exp(-h / tau) and exp(-h ratio / tau), those of the delay states at 0.

    h is the period and tau the time constant [s].
    """
    poles = [
        math.exp(-period / time_constant),
        math.exp(-period * second_pole_ratio / time_constant),
    ]
    poles += [0.0] * (len(plant.Gamma) - len(poles))
    return ForceLoop(plant, place_eigenvalues(plant.Phi, plant.Gamma, poles))
