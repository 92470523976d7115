"""A low-pass on the wrist sensor's readings; `SensorFrontEndConfig.filter_delay` is its delay."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.butterworth import butterworth
from multicontact_control.config import SensorFrontEndConfig
from multicontact_control.errors import ConfigError
import numpy as np


class LowPass:
    """
    A Butterworth low-pass of order 1 or 2, or none, that starts settled on the first reading.

    Parameters
    ----------
    config
        Order and cut-off.
    rate
        Rate of the readings [Hz].

    Raises
    ------
    ConfigError
        If the cut-off is not below half the rate.

    """

    def __init__(self, config: SensorFrontEndConfig, rate: float) -> None:
        self._b, self._a = np.ones(1), np.ones(1)
        if config.filter_order:
            if config.filter_cutoff >= 0.5 * rate:
                raise ConfigError(
                    'sensor.filter_cutoff', f'below the Nyquist frequency {0.5 * rate:g} Hz',
                    f'{config.filter_cutoff:g} Hz')
            self._b, self._a = butterworth(config.filter_order, config.filter_cutoff, rate)
        self.reset()

    def reset(self) -> None:
        """Start afresh with the next reading."""
        self._memory: list[Vector] | None = None

    def update(self, wrench: Vector) -> Vector:
        """
        Return the filtered reading (transposed direct form II, gain 1 at rest).

        A reading that is not finite is handed through and not remembered: who watches must see
        it, and the ones after it must not suffer.

        Parameters
        ----------
        wrench
            Next reading, shape (6,) [N, N m].

        """
        order = len(self._b) - 1
        if order == 0 or not np.isfinite(wrench).all():
            return wrench.copy()
        b, a = self._b, self._a
        if self._memory is None:
            self._memory = [wrench * (b[i:].sum() - a[i:].sum()) for i in range(1, order + 1)]
        memory = [*self._memory, np.zeros_like(wrench)]
        result: Vector = b[0] * wrench + memory[0]
        self._memory = [
            b[i] * wrench - a[i] * result + memory[i] for i in range(1, order + 1)]
        return result
