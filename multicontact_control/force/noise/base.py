"""What all estimators of the force noise have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
import math

from multicontact_control.arrays import Mask, require_shape, Vector
from multicontact_control.config import NoiseEstimatorConfig
import numpy as np

MAX_MAGNITUDE = 1e100  # sums of squares of samples below it stay finite


@dataclass(frozen=True, slots=True)
class Innovation:
    """
    The innovations of one tick, one per contact.

    All entries are 0 of a contact without one: not force controlled, or its observer just started.
    """

    innovation: Vector  # r = alpha - C x_1, shape (r,) [N]
    prior_variance: Vector  # C P_1 C^T, of the prediction, shape (r,) [N^2]
    variance_used: Vector  # R the observer worked with, shape (r,) [N^2]

    @property
    def valid(self) -> Mask:
        """Return the contacts that have an innovation, as a mask of shape (r,)."""
        mask: Mask = self.variance_used > 0.0
        return mask


class NoiseEstimator(ABC):
    """
    Samples in, variances out, one per contact.

    Until an estimate of a contact is known, its R is the configured `fixed_variance`. Every R
    lies within the bounds `noise_variance`, and changes by a factor e in `slew_time` at most.

    Parameters
    ----------
    config
        Contacts, rate, `slew_time`, and what the estimator itself needs.

    Attributes
    ----------
    uses_innovation
        Whether `update` needs the innovation.
    dropped
        Samples dropped so far because something in them was not finite or could not be squared.
    bounded
        Samples so far of which an R was at one of its bounds, by contact, shape (r,).

    """

    uses_innovation = False

    def __init__(self, config: NoiseEstimatorConfig) -> None:
        self.config = config
        self.dropped = 0
        self._unmeasured_ticks = 0  # in a row
        bounds = config.noise_variance
        self._smallest = bounds.smallest
        self._largest = bounds.largest
        self._contacts = len(config.contact_names)
        self.bounded = np.zeros(self._contacts, dtype=int)
        self._alpha: Vector = np.zeros(self._contacts)
        self._largest_step = math.inf
        if config.slew_time > 0.0:
            self._largest_step = math.exp(1.0 / (config.rate * config.slew_time))
        self.reset()

    def reset(self) -> None:
        """Forget all samples: every R is `fixed_variance` again; the counters go on."""
        self._variance: Vector = np.full(self._contacts, self.config.fixed_variance)
        self._given: Vector = np.clip(self._variance, self._smallest, self._largest)
        self._forget()

    def update(
        self,
        alpha: Vector,
        innovation: Innovation | None = None,
        *,
        measured: bool = True,
    ) -> Vector:
        """
        Take in the force of one tick.

        Parameters
        ----------
        alpha
            Measured forces, shape (r,) [N].
        innovation
            What the observers made of these forces. An estimator that `uses_innovation` and
            gets none gives its last R again; so it does for single contacts without one.
            The others take no notice of it.
        measured
            Whether the forces are of this tick. If not, they repeat the last reading, which says
            nothing of noise, and the last R is given again. After more such ticks than `window`
            the estimate begins anew: a force that is another one then is no noise.

        Returns
        -------
        Vector
            R for the next tick, shape (r,) [N^2]. A sample with anything in it that is not
            finite is dropped whole and counted in `dropped`, and the last R given again.

        Raises
        ------
        ShapeError
            If an array is not of shape (r,).

        """
        require_shape('alpha', alpha, self._alpha.shape)
        if not measured:
            self._unmeasured_ticks += 1
            return self._given.copy()
        if self._unmeasured_ticks > self.config.window:
            self._begin_estimate_anew()
        self._unmeasured_ticks = 0
        # A copy: numba would compile anew for an array of another layout.
        self._alpha[:] = alpha
        if not self._take(innovation):
            self.dropped += 1
        bounded: Vector = np.clip(self._variance, self._smallest, self._largest)
        self.bounded += bounded != self._variance
        self._given = np.clip(
            bounded, self._given / self._largest_step, self._given * self._largest_step
        )
        return self._given.copy()

    def _begin_estimate_anew(self) -> None:
        """Forget all samples, and let R go from its last value to `fixed_variance`."""
        given = self._given
        self.reset()
        self._given = given

    @abstractmethod
    def _forget(self) -> None:
        """Forget all samples."""

    @abstractmethod
    def _take(self, innovation: Innovation | None) -> bool:
        """Take in `_alpha`, set `_variance`; return False, nothing changed, if it is no use."""


def usable(values: Vector) -> bool:
    """Return whether all magnitudes are below MAX_MAGNITUDE, which that of NaN is not."""
    return bool((np.abs(values) < MAX_MAGNITUDE).all())
