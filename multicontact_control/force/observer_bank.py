"""The observers of all contacts side by side, as arrays for compiled code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.force.active_observer import ActiveObserver


class ObserverBank:
    """
    Design and memory of one active observer per contact.

    Parameters
    ----------
    observers
        One design per contact, all of the same order and delay.
    initial_covariance
        P_0 = initial_covariance I.

    Attributes
    ----------
    Phi_c, Phi_n, Gamma, feedback, Q, P_0
        Designs stacked along the first axis, see `observe_and_command`.
    order
        Of the active states.
    x_est, P, command, running
        Memory.

    """

    def __init__(self, observers: Sequence[ActiveObserver], initial_covariance: float) -> None:
        self.Phi_c: Matrix = np.stack([observer.Phi_c for observer in observers])
        self.Phi_n: Matrix = np.stack([observer.Phi_n for observer in observers])
        self.Gamma: Matrix = np.stack([observer.Gamma for observer in observers])
        self.feedback: Matrix = np.stack([observer.feedback for observer in observers])
        self.Q: Matrix = np.stack([observer.Q for observer in observers])
        self.P_0 = float(initial_covariance)
        self.order = observers[0].order
        self.x_est: Matrix = np.zeros_like(self.Gamma)
        self.P: Matrix = np.zeros_like(self.Phi_c)
        self.command: Vector = np.zeros(len(observers))
        self.running: Mask = np.zeros(len(observers), dtype=bool)
        # In the order `observe_and_command` takes them.
        self.arrays = (
            self.Phi_c, self.Phi_n, self.Gamma, self.feedback, self.Q, self.P_0, self.x_est,
            self.P, self.command, self.running)

    def continue_from(self, other: ObserverBank) -> bool:
        """
        Take over what observers of another design know; see `ActiveObserver.continue_from`.

        Returns
        -------
        bool
            Whether the sizes of the states agree; nothing is taken over otherwise.

        """
        if self.x_est.shape != other.x_est.shape or self.order != other.order:
            return False
        self.x_est[:], self.P[:], self.running[:] = other.x_est, other.P, other.running
        change = np.einsum('ij,ij->i', self.feedback - other.feedback, other.x_est)
        self.command[:] = other.command + change
        return True
