"""Force laws that are linear and do not change with time: one form, one compiled step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from multicontact_control.algebra import copy_vector
from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.compiled import compiled
from multicontact_control.errors import ConfigError
from multicontact_control.force.plant_model import DelayedPlant
from multicontact_control.records import LINEAR_LAW, MAX_STATES, Records
import numpy as np
from scipy.linalg import solve

INPUTS = ('alpha_meas', 'alpha_des', 'speed')
OUTPUTS = ('u', 'alpha_est', 'p_est')


@dataclass(frozen=True, slots=True)
class LoopModel:
    """
    What a force law is designed for (P04 eq. 32).

    Attributes
    ----------
    plant
        The delayed plant, discretised.
    stiffness
        k [N/m].
    damping_rate
        K_2 [1/s].
    input_delay
        T_d [s].
    period
        h [s].

    """

    plant: DelayedPlant
    stiffness: float
    damping_rate: float
    input_delay: float
    period: float


@dataclass(frozen=True)
class LinearLaw:
    """
    A force law x_(k+1) = A x_k + B y_k + E extra_k, outputs = C x_k + D y_k.

    Its inputs y are the measured force alpha [N], the desired one [N] and the speed of the contact
    point INTO the surface [m/s]; `extra` is what acts beyond the answer [m/s^2]. Its outputs are
    the acceleration u [m/s^2], without the damping K_2, the estimate of alpha [N], and that of
    the disturbance p that it compensates [m/s^2].

    Attributes
    ----------
    A, B, C, D
        Shapes (n, n), (n, 3), (3, n), (3, 3).
    E
        Shape (n,).
    start_force, start_disturbance
        State at a touch, for a felt force of 1 N and for a known disturbance of 1 m/s^2, shape
        (n,).

    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    E: Vector
    start_force: Vector
    start_disturbance: Vector

    def __post_init__(self) -> None:
        n = self.A.shape[0]
        if n > MAX_STATES:
            raise ConfigError('force law', f'at most {MAX_STATES} states', n)
        for name, shape in (('A', (n, n)), ('B', (n, len(INPUTS))), ('C', (len(OUTPUTS), n)),
                            ('D', (len(OUTPUTS), len(INPUTS)))):
            require_shape(name, getattr(self, name), shape)
        for name in ('E', 'start_force', 'start_disturbance'):
            require_shape(name, getattr(self, name), (n,))

    @property
    def states(self) -> int:
        """Return n."""
        return int(self.A.shape[0])

    def record(self) -> Records:
        """Return it as one record of `LINEAR_LAW` that knows nothing yet."""
        law, n = np.zeros(1, dtype=LINEAR_LAW), self.states
        law['states'], law['D'] = n, self.D
        law['A'][0, :n, :n], law['B'][0, :n], law['C'][0, :, :n] = self.A, self.B, self.C
        for name in ('E', 'start_force', 'start_disturbance'):
            law[name][0, :n] = getattr(self, name)
        return law


def sampled(
    A: Matrix, B: Matrix, C: Matrix, D: Matrix, period: float, *, E: Vector | None = None,
    start_force: Vector | None = None, start_disturbance: Vector | None = None,
) -> LinearLaw:
    """
    Return a law that is given in continuous time, discretised by the bilinear transformation.

    `scipy.signal.cont2discrete` gives the same bits; to import it takes 0.7 s, in which an arm
    whose law is changed would get no command.

    Parameters
    ----------
    A, B, C, D
        As of `LinearLaw`, but dx/dt = A x + B y.
    period
        h [s].
    E
        What adds to dx/dt for an acceleration that acts beyond the answer; zero if not given.
    start_force, start_disturbance
        The continuous state x at a touch, as of `LinearLaw`; zero if not given.

    """
    # The discrete state is (1 - A h / 2) x - B y h / 2.
    change = np.eye(len(A)) - 0.5 * period * A
    A_d = solve(change, np.eye(len(A)) + 0.5 * period * A)
    B_d = solve(change, period * B)
    C_d = solve(change.T, C.T).T
    D_d = D + 0.5 * (C @ B_d)
    extra, force, disturbance = (
        np.zeros(len(A)) if vector is None else vector
        for vector in (E, start_force, start_disturbance))
    return LinearLaw(
        A_d, B_d, C_d, D_d, period * extra, change @ force - 0.5 * period * B[:, 0],
        change @ disturbance)


@compiled
def start_linear(law: Any, force: float, disturbance: float) -> None:
    """Begin with a felt force [N] and a disturbance that is known [m/s^2]."""
    for i in range(law.states):
        law.x[i] = law.start_force[i] * force + law.start_disturbance[i] * disturbance
    law.extra = 0.0
    law.alpha = force
    law.p_est = disturbance
    law.running = True


@compiled
def step_linear(law: Any, contact: Any, speed: float) -> float:
    """
    Take one sample into a linear force law.

    Parameters
    ----------
    law
        Record of `LINEAR_LAW`, changed.
    contact
        Record of `CONTACT`; its estimates are filled in. A force that was not measured is the
        one before.
    speed
        Of the contact point INTO the surface [m/s].

    Returns
    -------
    float
        u, the acceleration along the contact normal without the damping K_2 [m/s^2].

    """
    if not law.running:
        start_linear(law, contact.alpha_meas, 0.0)
    n, A, B, C, D = law.states, law.A, law.B, law.C, law.D
    x, x_next, E = law.x, law.x_next, law.E
    alpha, desired, extra = contact.alpha_meas, contact.alpha_des, law.extra
    for i in range(n):
        x[i] += E[i] * extra
    for i in range(n):
        x_next[i] = B[i, 0] * alpha + B[i, 1] * desired + B[i, 2] * speed
        for j in range(n):
            x_next[i] += A[i, j] * x[j]
    u = D[0, 0] * alpha + D[0, 1] * desired + D[0, 2] * speed
    estimate = D[1, 0] * alpha + D[1, 1] * desired + D[1, 2] * speed
    disturbance = D[2, 0] * alpha + D[2, 1] * desired + D[2, 2] * speed
    for j in range(n):
        u += C[0, j] * x[j]
        estimate += C[1, j] * x[j]
        disturbance += C[2, j] * x[j]
    copy_vector(x_next, x)
    law.extra = 0.0
    law.p_est = disturbance
    law.alpha = estimate
    contact.alpha_est = estimate
    return u
