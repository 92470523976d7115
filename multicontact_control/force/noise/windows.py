"""
The mean over the last N samples, one per contact.

Recomputed from the samples each time: a running sum would keep the rounding of every large
sample for ever.
"""

from __future__ import annotations

from multicontact_control.arrays import Mask, Matrix, Vector
import numpy as np


class WindowedMean:
    """
    Mean over the last N samples of each contact; contacts may miss samples.

    Parameters
    ----------
    window
        N.
    contacts
        r.

    """

    def __init__(self, window: int, contacts: int) -> None:
        self._samples: Matrix = np.zeros((window, contacts))
        self._counts = np.zeros(contacts, dtype=int)

    @property
    def full(self) -> Mask:
        """Which contacts have had N samples, shape (r,)."""
        mask: Mask = self._counts >= self._samples.shape[0]
        return mask

    def update(self, samples: Vector, valid: Mask) -> Vector:
        """
        Take in one sample of every contact that has one.

        Parameters
        ----------
        samples
            Shape (r,).
        valid
            Which of them count, shape (r,).

        Returns
        -------
        Vector
            Mean of each contact's window as if empty places held 0, shape (r,).

        """
        contacts = np.flatnonzero(valid)
        rows = self._counts[contacts] % self._samples.shape[0]
        self._samples[rows, contacts] = samples[contacts]
        self._counts[contacts] += 1
        mean: Vector = self._samples.sum(axis=0) / self._samples.shape[0]
        return mean
