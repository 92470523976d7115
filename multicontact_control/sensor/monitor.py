"""
Whether the wrist sensor still measures: saturated axes, and readings that never change.

A frozen sensor repeats itself, but so does a live one now and then: its converter has steps, and
two readings fall on the same one by chance. A single axis with noise of standard deviation sigma
and step D repeats with a probability of about D / (2 sqrt(pi) sigma), 4 to 15 % for a 14-bit JR3
with 0.047 N and 0.004 N m of noise; all six axes together 6e-8, and 5 equal readings in a row
5e-28 (`repeat_probability` with `samples` 5 gives the exact worst case). A sensor whose noise is
far below a step repeats for ever while it is at rest: `frozen_ticks` must be 0 for it.
"""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import Mask, require_shape, Vector
from multicontact_control.config import SensorFrontEndConfig
import numpy as np
from scipy.special import ndtr

OFFSETS = np.linspace(0.0, 0.5, 26)


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """
    The state of the sensor at one sample.

    Attributes
    ----------
    saturated
        Which axes are at full scale, shape (6,); none where full scale is not known.
    frozen
        Whether the last `frozen_ticks` readings were all the same in all axes.

    """

    saturated: Mask
    frozen: bool

    @property
    def fault(self) -> str:
        """Return what is wrong, ``frozen`` or ``saturated``; empty if nothing is."""
        if self.frozen:
            return 'frozen'
        return 'saturated' if any(self.saturated.tolist()) else ''  # a quarter of numpy's time


class SensorMonitor:
    """
    Watch raw readings, one per tick.

    Parameters
    ----------
    config
        Full scale and how many equal readings mean frozen.

    """

    def __init__(self, config: SensorFrontEndConfig) -> None:
        self._limit = np.full(6, np.inf)
        if config.full_scale:
            self._limit = config.saturation_fraction * np.array(config.full_scale)
        self._frozen_ticks = config.frozen_ticks
        self.reset()

    def reset(self) -> None:
        """Forget the readings so far."""
        self._last = b''
        self._equal = 0

    def update(self, wrench_sensor: Vector) -> SensorHealth:
        """
        Take the next raw reading: as the sensor gave it, before any filter or bias.

        Parameters
        ----------
        wrench_sensor
            Shape (6,) [N, N m].

        Raises
        ------
        ShapeError
            If it is not of that shape.

        """
        require_shape('wrench_sensor', wrench_sensor, (6,))
        bits = wrench_sensor.tobytes()  # a tenth of the time of comparing arrays
        self._equal = self._equal + 1 if bits == self._last else 1
        self._last = bits
        return SensorHealth(
            saturated=np.abs(wrench_sensor) >= self._limit,
            frozen=0 < self._frozen_ticks <= self._equal)


def repeat_probability(noise_std: Vector, steps: Vector, samples: int = 2) -> float:
    """
    Return how likely a live, quantised sensor gives equal readings in a row in all its axes.

    prod over the axes of sum_k p_k^samples, p_k the probability of converter step k, at the true
    values that make it most likely.

    Parameters
    ----------
    noise_std
        Standard deviation of the white noise of each axis, shape (m,), > 0.
    steps
        Converter step of each axis, shape (m,), in the same unit.
    samples
        Number of equal readings.

    Returns
    -------
    float
        Probability that `samples` given readings are all equal.

    """
    chance = 1.0
    for std, step in zip(np.asarray(noise_std).tolist(), np.asarray(steps).tolist()):
        reach = int(np.ceil(8.0 * std / step)) + 1
        edges = (np.arange(-reach, reach + 2) - 0.5 + OFFSETS[:, None]) * (step / std)
        chance *= float(np.max(np.sum(np.diff(ndtr(edges), axis=1) ** samples, axis=1)))
    return chance
