"""The observers of all contacts side by side, as arrays for compiled code."""

from __future__ import annotations

from collections.abc import Sequence

from multicontact_control.arrays import Matrix
from multicontact_control.force.active_observer import ActiveObserver
from multicontact_control.force.kernels import (
    ESTIMATE,
    FEEDBACK,
    GAMMA,
    MATRICES,
    PHI_C,
    PHI_N,
    PROCESS_NOISE,
    SCALARS,
    VECTORS,
)
import numpy as np


class ObserverBank:
    """
    Design and memory of one active observer per contact.

    Stacked into three arrays because every array that is handed to compiled code costs time.

    Parameters
    ----------
    observers
        One design per contact, all of the same order and delay: m states.
    initial_covariance
        P_0 = initial_covariance I.

    Attributes
    ----------
    matrices
        Phi_c and Phi_n of the designs and the covariances P, shape (3, r, m, m).
    vectors
        Gamma, feedback [L_r 1] and diagonal of Q of the designs and the estimates, shape
        (4, r, m).
    scalars
        The command r = L_1 f_des of the tick before, and whether the observer ran then (1 or 0),
        shape (2, r).
    P_0
        Initial variance of every state.

    """

    def __init__(self, observers: Sequence[ActiveObserver], initial_covariance: float) -> None:
        count, states = len(observers), observers[0].Gamma.shape[0]
        self.matrices: Matrix = np.zeros((len(MATRICES), count, states, states))
        self.vectors: Matrix = np.zeros((len(VECTORS), count, states))
        self.scalars: Matrix = np.zeros((len(SCALARS), count))
        self.P_0 = float(initial_covariance)
        for i, observer in enumerate(observers):
            self.matrices[PHI_C, i] = observer.Phi_c
            self.matrices[PHI_N, i] = observer.Phi_n
            self.vectors[GAMMA, i] = observer.Gamma
            self.vectors[FEEDBACK, i] = observer.feedback
            self.vectors[PROCESS_NOISE, i] = observer.Q

    @property
    def x_est(self) -> Matrix:
        """State estimates, shape (r, m)."""
        return self.vectors[ESTIMATE]

    @property
    def feedback(self) -> Matrix:
        """[L_r 1] of every observer, shape (r, m)."""
        return self.vectors[FEEDBACK]
