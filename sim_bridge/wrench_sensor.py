"""The wrist force/torque sensor: what it makes of the true wrench, after a JR3."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.butterworth import butterworth
from multicontact_control.compiled import compiled
from multicontact_control.errors import ConfigError
import numpy as np
from sim_bridge.config import SensorConfig

# A JR3's outputs are a chain of low-passes, each a quarter of the one before.
CASCADE_HIGHEST = 500.0
CASCADE_RATIO = 4.0
AXES = 6
NOISE_BLOCK = 1024


class WrenchSensor:
    """
    A sensor that is read once per integration step.

    Reading = quantise(saturate(mounting true + bias + noise)). The low-passes work on the
    readings, as the instrument's own signal processor does, and start from the first one.

    Parameters
    ----------
    config
        The sensor.
    period
        Time between readings [s].
    generator
        Source of the noise.

    Raises
    ------
    ConfigError
        If the cut-off is not below half the rate of the readings.

    """

    def __init__(
        self, config: SensorConfig, period: float, generator: np.random.Generator,
    ) -> None:
        self._generator = generator
        self._mounting = np.array(config.mounting).reshape(3, 3) if config.mounting else None
        self._bias = np.array(config.bias)
        self._scale = np.array(config.full_scale)
        self._limit = self._scale if config.saturate else np.full(AXES, np.inf)
        self._quantum = quantum(config) if config.quantise else np.zeros(AXES)
        self._std = np.zeros(AXES)
        if config.noise:
            self._std = np.repeat((config.force_noise_std, config.torque_noise_std), 3)
        self._noise = np.zeros((NOISE_BLOCK, AXES))
        self._next_noise = NOISE_BLOCK
        self._stages = np.zeros((0, 5))
        if config.low_pass:
            self._stages = low_pass_stages(config.low_pass_cutoff, 1.0 / period)
        self._memory = np.zeros((len(self._stages), AXES, 2))
        self._started = False
        self.reading = np.zeros(AXES)
        self.filtered = np.zeros(AXES)

    def read(self, wrench: Vector) -> None:
        """
        Take the next reading; it is then in `reading` and `filtered`.

        Parameters
        ----------
        wrench
            True wrench in the sensor's frame, shape (6,) [N, N m].

        """
        if self._next_noise == NOISE_BLOCK:
            self._noise[:] = self._generator.standard_normal((NOISE_BLOCK, AXES)) * self._std
            self._next_noise = 0
        if self._mounting is not None:
            wrench = (wrench.reshape(2, 3) @ self._mounting.T).ravel()
        measure(wrench, self._bias, self._noise[self._next_noise], self._limit, self._quantum,
                self.reading)
        self._next_noise += 1
        if not self._started:
            settle(self.reading, self._stages, self._memory)
            self._started = True
        low_pass(self.reading, self._stages, self._memory, self.filtered)


def quantum(config: SensorConfig) -> Vector:
    """Return one step of each axis: the range, both signs, over 2^bits, shape (6,)."""
    return np.asarray(2.0 * np.array(config.full_scale) / 2 ** config.bits)


def low_pass_stages(cutoff: float, rate: float) -> Matrix:
    """
    Return the chain of second-order Butterworth low-passes down to a cut-off.

    The stages lie at 500, 125, 31.25, ... Hz as far as they are above twice the cut-off and
    below the Nyquist frequency; the last one lies at the cut-off. The chain's gain at the cut-off
    is -3.03 dB if the stage before it is four times as high, -3.01 dB without one.

    Parameters
    ----------
    cutoff
        Cut-off of the last stage [Hz].
    rate
        Rate of the readings [Hz].

    Returns
    -------
    Matrix
        b0, b1, b2, a1, a2 of each stage, shape (stages, 5).

    Raises
    ------
    ConfigError
        If the cut-off is not below half the rate.

    """
    nyquist = 0.5 * rate
    if cutoff >= nyquist:
        raise ConfigError(
            'sensor.low_pass_cutoff', f'below half the rate of the substeps ({nyquist:g} Hz)',
            f'{cutoff:g} Hz')
    corners = []
    corner = CASCADE_HIGHEST
    while corner > 2.0 * cutoff:
        if corner < nyquist:
            corners.append(corner)
        corner /= CASCADE_RATIO
    stages = [butterworth(2, corner, rate) for corner in [*corners, cutoff]]
    return np.array([(*b, *a[1:]) for b, a in stages])


@compiled
def measure(
    wrench: Vector, bias: Vector, noise: Vector, limit: Vector, steps: Vector, reading: Vector,
) -> None:
    """
    Fill `reading` with the wrench as the converter sees it.

    Parameters
    ----------
    wrench, bias, noise
        Added up, shape (6,) [N, N m].
    limit
        Full scale, infinite for none, shape (6,).
    steps
        Size of a converter step, 0 for none, shape (6,).
    reading
        Filled, shape (6,).

    """
    for axis in range(wrench.shape[0]):
        value = wrench[axis] + bias[axis] + noise[axis]
        value = min(max(value, -limit[axis]), limit[axis])
        if steps[axis] > 0.0:
            value = steps[axis] * np.rint(value / steps[axis])
        reading[axis] = value


@compiled
def settle(value: Vector, stages: Matrix, memory: Matrix) -> None:
    """Set the filters' memory, shape (stages, 6, 2), as if `value` had always been there."""
    for stage in range(stages.shape[0]):
        b0, b1, b2, a1, a2 = stages[stage]
        for axis in range(value.shape[0]):
            memory[stage, axis, 0] = value[axis] * (1.0 - b0)
            memory[stage, axis, 1] = value[axis] * (b2 - a2)


@compiled
def low_pass(value: Vector, stages: Matrix, memory: Matrix, result: Vector) -> None:
    """
    Advance the chain by one reading (transposed direct form II, gain 1 at rest).

    Parameters
    ----------
    value
        The reading, shape (6,).
    stages
        From `low_pass_stages`.
    memory
        Updated, shape (stages, 6, 2).
    result
        Filled with the last stage's output, shape (6,).

    """
    for axis in range(value.shape[0]):
        signal = value[axis]
        for stage in range(stages.shape[0]):
            b0, b1, b2, a1, a2 = stages[stage]
            output = b0 * signal + memory[stage, axis, 0]
            memory[stage, axis, 0] = b1 * signal - a1 * output + memory[stage, axis, 1]
            memory[stage, axis, 1] = b2 * signal - a2 * output
            signal = output
        result[axis] = signal
