"""
The one way of a reading from the wrist sensor into the loop: watched, then low-passed.

A frozen sensor repeats itself, but so does a live one now and then: its converter has steps, and
two readings fall on the same one by chance. A single axis with noise of standard deviation sigma
and step D repeats with a probability of about D / (2 sqrt(pi) sigma), 4 to 15 % for a 14-bit JR3
with 0.047 N and 0.004 N m of noise; all six axes together 6e-8, and 5 equal readings in a row
5e-28 (a test works both out). A sensor whose noise is far below a step repeats for ever while it
is at rest: `frozen_ticks` must be 0 for it.
"""

from __future__ import annotations

from operator import ge

from multicontact_control.arrays import require_shape, Vector
from multicontact_control.butterworth import butterworth
from multicontact_control.config import SensorFrontEndConfig
from multicontact_control.errors import ConfigError
import numpy as np


class SensorFrontEnd:
    """
    Watch and filter the readings of a wrist sensor, one per tick.

    Parameters
    ----------
    config
        What to do.
    rate
        Rate of the readings [Hz].

    Raises
    ------
    ConfigError
        If the low-pass does not fit the rate.

    """

    def __init__(self, config: SensorFrontEndConfig, rate: float) -> None:
        self._limits = [config.saturation_fraction * limit for limit in config.full_scale]
        self._frozen_ticks = config.frozen_ticks
        self._low_pass = LowPass(config, rate) if config.filter_order else None
        self.reset()

    def reset(self) -> None:
        """Forget the readings so far."""
        self._last = b''
        self._equal = 0
        if self._low_pass is not None:
            self._low_pass.reset()

    def update(self, wrench_sensor: Vector) -> tuple[Vector, str]:
        """
        Take the next reading, as the sensor gave it.

        Parameters
        ----------
        wrench_sensor
            Shape (6,) [N, N m].

        Returns
        -------
        wrench_sensor : Vector
            Low-passed, or the very reading, bias and weight still in it, shape (6,) [N, N m].
        fault : str
            ``frozen`` if the last `frozen_ticks` readings were the same in all axes,
            ``saturated`` if an axis is at full scale, empty if nothing is wrong.

        Raises
        ------
        ShapeError
            If it is not of that shape.

        """
        if wrench_sensor.shape != (6,):
            require_shape('wrench_sensor', wrench_sensor, (6,))
        bits = wrench_sensor.tobytes()  # a tenth of the time of comparing arrays
        self._equal = self._equal + 1 if bits == self._last else 1
        self._last = bits
        fault = ''
        if 0 < self._frozen_ticks <= self._equal:
            fault = 'frozen'
        elif any(map(ge, map(abs, wrench_sensor.tolist()), self._limits)):  # numpy takes 3 us
            fault = 'saturated'
        if self._low_pass is not None:
            wrench_sensor = self._low_pass.update(wrench_sensor)
        return wrench_sensor, fault


class LowPass:
    """
    A Butterworth low-pass of order 1 or 2 that starts settled on the first reading.

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
        if not np.isfinite(wrench).all():
            return wrench
        b, a, order = self._b, self._a, len(self._b) - 1
        if self._memory is None:
            self._memory = [wrench * (b[i:].sum() - a[i:].sum()) for i in range(1, order + 1)]
        memory = [*self._memory, np.zeros_like(wrench)]
        result: Vector = b[0] * wrench + memory[0]
        self._memory = [
            b[i] * wrench - a[i] * result + memory[i] for i in range(1, order + 1)]
        return result
