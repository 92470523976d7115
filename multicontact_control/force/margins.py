"""
How far the force loops of an arm are from instability.

P04 eq. 32 takes a contact for k e^(-s T_d) / (s (s + K_2)). `closed_loop` adds what an arm has
besides: the contact force accelerates it, and only its delayed estimate is fed forward against it
(eq. 24); the damping K_2 acts on the measured motion, and so is delayed, too; the surface damps;
the contacts act on each other through the arm; and the wrist sensor weighs the inertia of the tool
with the contact force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.force.laws.linear import (
    ALPHA_EST,
    ALPHA_MEAS,
    LinearLaw,
    SPEED,
    U,
)
from multicontact_control.force.plant import discretise_delayed_input
import numpy as np


@dataclass(frozen=True)
class LinearArmPlant:
    """
    The plant that the force loops meet.

    d^2z/dt^2 = u(t - T) - K dz/dt - B alpha with alpha = k z + c dz/dt, where z are the ways of
    the contact points into their surfaces; measured is alpha + M_t d^2z/dt^2. With K = K_2 and
    without B, c and M_t each contact is G(s) of P04 eq. 32.
    """

    mobility: Matrix  # B = N^T Lambda^-1 N, shape (r, r) [1/kg]
    stiffness: Vector  # k, shape (r,) [N/m]
    damping: Vector  # c, shape (r,) [N s/m]
    tool_inertia: Matrix  # M_t, shape (r, r) [kg]
    delay: float  # T, from a sample to the torque that answers it [s]
    damping_rate: float = 0.0  # K, which is there without being commanded [1/s]


def closed_loop(
    plant: LinearArmPlant,
    law: LinearLaw,
    damping_rate: float,
    period: float,
    *,
    fed_share: float = 0.0,
) -> Matrix:
    """
    Return the matrix of one period of all force loops together.

    Of the state [z, dz/dt, inputs under way, measured forces, x of every law], with the commanded
    forces 0. A sample is answered by w = u - K_2 dz/dt + B (1 - g) alpha_est.

    Parameters
    ----------
    plant, law
        What the loops meet, and the force law of every contact.
    damping_rate, period
        K_2 on the measured motion [1/s], 0 where the plant itself has it, and h [s].
    fed_share
        g, the share of the desired force in what is fed forward.

    """
    r = len(plant.stiffness)
    n = law.states
    zero = np.zeros((r, r))
    one = np.eye(r)
    # alpha of z and dz/dt
    force = np.hstack([np.diag(plant.stiffness), np.diag(plant.damping)])
    acceleration = -plant.mobility @ force
    acceleration[:, r:] -= plant.damping_rate * one
    Phi, Gamma = discretise_delayed_input(
        np.vstack([np.hstack([zero, one]), acceleration]),
        np.vstack([zero, one]),
        plant.delay,
        period,
    )
    real = len(Phi)  # states of the plant, with the inputs under way
    own = real + r  # where the states of the laws begin
    size = own + n * r
    # What the laws answer: to the measured forces, to the speeds, and by what they remember.
    output = {}
    for row in (U, ALPHA_EST):
        output[row] = np.zeros((r, size))
        output[row][:, real:own] = law.D[row, ALPHA_MEAS] * one
        output[row][:, r : 2 * r] = law.D[row, SPEED] * one
        output[row][:, own:] = np.kron(one, law.C[[row]])
    answer = output[U] + (1.0 - fed_share) * plant.mobility @ output[ALPHA_EST]
    answer[:, r : 2 * r] -= damping_rate * one
    loop = np.zeros((size, size))
    loop[:real] = Gamma @ answer
    loop[:real, :real] += Phi
    motion = loop[: 2 * r]
    loop[real:own] = force @ motion + plant.tool_inertia @ (
        acceleration @ motion + _acting_input(plant, answer, real, period)
    )
    loop[own:, real:own] = np.kron(one, law.B[:, [ALPHA_MEAS]])
    loop[own:, r : 2 * r] = np.kron(one, law.B[:, [SPEED]])
    loop[own:, own:] = np.kron(one, law.A)
    return loop


def _acting_input(
    plant: LinearArmPlant, answer: Matrix, real: int, period: float
) -> Matrix:
    """Return, as rows, the inputs that act at the end of the period."""
    waiting = plant.delay / period
    r = len(answer)
    whole = math.floor(waiting + 1e-9) == math.ceil(waiting - 1e-9)  # still the oldest
    first = 2 * r if whole else 3 * r
    if first >= real:
        return answer
    return np.eye(answer.shape[1])[first : first + r]


def spectral_radius(matrix: Matrix) -> float:
    """Return the largest magnitude of the eigenvalues."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def find_last_stable(
    stable: Callable[[float], bool],
    ratios: Sequence[float],
    tolerance: float,
) -> tuple[float, float]:
    """
    Return a stable and an unstable ratio next to each other, the first from below.

    Walks up the ratios to the first unstable one, then halves the step to a relative
    `tolerance`. Stable islands beyond it do not count. (0, 0) if not even the first is stable,
    infinities if all are.
    """
    low = 0.0
    for high in ratios:
        if stable(high):
            low = high
            continue
        while low and high / low - 1.0 > tolerance:
            middle = math.sqrt(low * high)
            if stable(middle):
                low = middle
            else:
                high = middle
        return (low, high) if low else (0.0, 0.0)
    return math.inf, math.inf
