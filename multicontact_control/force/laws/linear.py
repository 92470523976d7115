"""
Force laws that are linear: x_(k+1) = A x_k + B y_k, with one compiled step for all of them.

A design begins with `make_zero_law` and fills its matrices by the names of inputs and outputs; the
compiled step works on the record that `LinearLaw.record` makes of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.errors import ConfigError
from multicontact_control.records import (
    MAX_STATES,
    Record,
    record_dtype,
    Records,
)
import numpy as np
from scipy.linalg import solve

# The inputs y of a linear law, which are columns of B and D: the measured force and the desired
# one [N], and the speed of the contact point into the surface [m/s].
ALPHA_MEAS, ALPHA_DES, SPEED = range(3)
INPUTS = ('alpha_meas', 'alpha_des', 'speed')

# Its outputs, which are rows of C and D: the acceleration u [m/s^2], the estimated force [N], and
# the disturbance that the law compensates [m/s^2].
U, ALPHA_EST, P_EST = range(3)
OUTPUTS = ('of_u', 'of_alpha', 'of_p')


class LinearRow(Record, Protocol):
    """What one state or output of a linear law has of its states and inputs: A or C, B or D."""

    x: Annotated[Vector, MAX_STATES]
    alpha_meas: float
    alpha_des: float
    speed: float


LINEAR_ROW = record_dtype(LinearRow)


class LinearDesign(Record, Protocol):
    """What a linear law works by."""

    states: int  # n
    of_state: Annotated[Records[LinearRow], MAX_STATES]  # x_(k+1) = A x_k + B y_k

    # C x_k + D y_k.
    of_u: LinearRow
    of_alpha: LinearRow
    of_p: LinearRow

    E: Annotated[Vector, MAX_STATES]  # added to x_(k+1) for 1 m/s^2 beyond the answer
    start_force: Annotated[Vector, MAX_STATES]  # state at touch, for 1 N that is felt

    # And for a known disturbance of 1 m/s^2.
    start_disturbance: Annotated[Vector, MAX_STATES]


class Linear(Record, Protocol):
    """
    A linear force law.

    From alpha_meas, alpha_des and the contact's speed to u, alpha_est and p_est.
    """

    design: LinearDesign

    # Acceleration that acted beyond the answer of the sample before [m/s^2].
    extra: float

    running: bool  # whether there was a sample before
    x: Annotated[Vector, MAX_STATES]  # state
    alpha: float  # estimated force [N]
    p_est: float  # disturbance that the law compensates [m/s^2]


LINEAR = record_dtype(Linear)


@dataclass(frozen=True)
class LinearLaw:
    """
    A force law x_(k+1) = A x_k + B y_k + E extra_k with the outputs C x_k + D y_k.

    Inputs and outputs are named above; u is without the damping K_2, and `extra` is what acts
    beyond it [m/s^2]. `make_zero_law` makes one whose arrays a design then fills.
    """

    A: Matrix  # shape (n, n)
    B: Matrix  # shape (n, 3)
    C: Matrix  # shape (3, n)
    D: Matrix  # shape (3, 3)
    E: Vector  # shape (n,)

    # The state at a touch: for a felt force of 1 N, and for a known disturbance of 1 m/s^2.
    start_force: Vector  # shape (n,)
    start_disturbance: Vector  # shape (n,)

    @property
    def states(self) -> int:
        """Return the number of states n."""
        return len(self.A)

    def record(self) -> Records[Linear]:
        """Return the law as one record of `LINEAR`, at state zero, as compiled code steps it."""
        law = np.zeros(1, dtype=LINEAR)
        design = law['design'][0]
        n = self.states
        design['states'] = n
        rows = design['of_state'][:n]
        rows['x'][:, :n] = self.A
        for name, column in zip(INPUTS, self.B.T):
            rows[name] = column
        for output, of_states, of_inputs in zip(OUTPUTS, self.C, self.D):
            row = design[output]
            row['x'][:n] = of_states
            for name, value in zip(INPUTS, of_inputs):
                row[name] = value
        for name in ('E', 'start_force', 'start_disturbance'):
            design[name][:n] = getattr(self, name)
        return law


def make_zero_law(states: int) -> LinearLaw:
    """
    Return a law of so many states whose arrays are zero, for a design to fill.

    Raises
    ------
    ConfigError
        For more than `MAX_STATES` states, which is what the record of a law has room for.

    """
    if states > MAX_STATES:
        raise ConfigError('force law', f'at most {MAX_STATES} states', states)
    return LinearLaw(
        A=np.zeros((states, states)),
        B=np.zeros((states, len(INPUTS))),
        C=np.zeros((len(OUTPUTS), states)),
        D=np.zeros((len(OUTPUTS), len(INPUTS))),
        E=np.zeros(states),
        start_force=np.zeros(states),
        start_disturbance=np.zeros(states),
    )


def discretise_law(law: LinearLaw, period: float) -> LinearLaw:
    """
    Return a law dx/dt = A x + B y + E extra, discretised by the bilinear transformation.

    The discrete state is (1 - A h / 2) x - B y h / 2.

    Parameters
    ----------
    law
        The continuous law; its start is that of the continuous state.
    period
        h [s].

    """
    # As scipy.signal.cont2discrete, which takes 0.7 s to import while an arm waits.
    one = np.eye(law.states)
    change = one - 0.5 * period * law.A
    B = solve(change, period * law.B)
    return LinearLaw(
        A=solve(change, one + 0.5 * period * law.A),
        B=B,
        C=solve(change.T, law.C.T).T,
        D=law.D + 0.5 * (law.C @ B),
        E=period * law.E,
        start_force=change @ law.start_force - 0.5 * period * law.B[:, ALPHA_MEAS],
        start_disturbance=change @ law.start_disturbance,
    )
