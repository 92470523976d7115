"""What all estimators of the force noise have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
import math

from multicontact_control.arrays import Mask, require_shape, Vector
from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.force.noise.innovation import Innovation
from multicontact_control.force.noise.kernels import all_below, settle_variance
import numpy as np

MAX_MAGNITUDE = 1e100  # sums of squares of samples below it stay finite


class NoiseEstimator(ABC):
    """
    Samples in, variances out, one per contact.

    Until an estimate of a contact is known, its R is the configured `fixed_variance`. Every R
    lies between `variance_floor` and `variance_ceiling`, and changes by a factor e in `slew_time`
    at most.

    Parameters
    ----------
    config
        Contacts, limits, and what the estimator itself needs.

    Attributes
    ----------
    uses_innovation
        Whether `update` needs the innovation.
    dropped
        Samples dropped so far because something in them was not finite or could not be squared.

    """

    uses_innovation = False

    def __init__(self, config: NoiseEstimatorConfig) -> None:
        self.config = config
        self.dropped = 0
        self._contacts = len(config.contact_names)
        self._alpha: Vector = np.zeros(self._contacts)
        self._largest_step = math.exp(1.0 / (config.rate * config.slew_time)) if (
            config.slew_time > 0.0) else math.inf
        self._limits = config.variance_scale, config.variance_floor, config.variance_ceiling
        self.reset()
        zero, one = np.zeros(self._contacts), np.ones(self._contacts)
        self.update(zero, Innovation(zero, one, one))  # compiles what no tick should wait for
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._variance: Vector = self._clamp(np.full(self._contacts, self.config.fixed_variance))
        self._given = self._variance.copy()
        self._forget()

    def update(self, alpha: Vector, innovation: Innovation | None = None) -> Vector:
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
        if alpha.shape != self._alpha.shape:
            require_shape('alpha', alpha, self._alpha.shape)
        self._alpha[:] = alpha  # whatever its layout: numba would compile anew for another one
        if not self._take(innovation):
            self.dropped += 1
        if self._largest_step == math.inf:
            return self._variance.copy()
        self._given = np.clip(
            self._variance, self._given / self._largest_step, self._given * self._largest_step)
        return self._given.copy()

    def _clamp(self, variance: Vector) -> Vector:
        clamped: Vector = np.clip(
            variance, self.config.variance_floor, self.config.variance_ceiling)
        return clamped

    @abstractmethod
    def _forget(self) -> None:
        """Forget all samples."""

    @abstractmethod
    def _take(self, innovation: Innovation | None) -> bool:
        """
        Take in the sample in `_alpha` and put what is known now in `_variance`.

        Returns
        -------
        bool
            Whether all numbers could be used; if not, nothing has changed.

        """


class InnovationEstimator(NoiseEstimator):
    """An estimator that works on the observers' innovations alone."""

    uses_innovation = True

    def _take(self, innovation: Innovation | None) -> bool:
        usable = all_below(self._alpha, MAX_MAGNITUDE)
        if innovation is None:
            return usable
        for name in ('innovation', 'prior_variance', 'variance_used'):
            values = getattr(innovation, name)
            require_shape(name, values, self._alpha.shape)
            usable = usable and bool((np.abs(values) < MAX_MAGNITUDE).all())  # not so for NaN
        if usable:
            estimate, known = self._estimate_from(innovation)
            settle_variance(estimate, known, *self._limits, self._variance)
        return usable

    @abstractmethod
    def _estimate_from(self, innovation: Innovation) -> tuple[Vector, Mask]:
        """
        Take in innovations of finite numbers.

        Returns
        -------
        tuple
            Estimated variances, shape (r,) [N^2], and which of them are known.

        """
