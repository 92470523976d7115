"""The wrist force/torque sensor: what it makes of the true wrench, after a JR3."""

from __future__ import annotations

from typing import Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.errors import ConfigError
from multicontact_control.records import (
    Record,
    record_dtype,
    Records,
)
import numpy as np
from sim_bridge.config import SensorConfig

# A JR3's outputs are a chain of low-passes, each a quarter of the one before.
CASCADE_HIGHEST = 500.0
CASCADE_RATIO = 4.0
AXES = 6
READINGS_DRAWN = 16  # times as many readings as are taken at once, whose noise is drawn


class Axis(Record, Protocol):
    """One axis: what is set for it, and its newest reading [N or N m]."""

    bias: float
    noise_std: float
    limit: float  # full scale, infinite for none
    quantum: float  # size of a converter step, 0 for none
    reading: float
    filtered: float  # the reading behind the low-passes


AXIS = record_dtype(Axis)


class WrenchSensor:
    """
    A sensor that takes one reading per integration step, which is a period [s] long.

    Reading = quantise(saturate(mounting true + bias + noise)). The low-passes work on the
    readings, as the instrument's own signal processor does, and start from the first one.
    Raises ConfigError if their cut-off is not below half the rate of the readings.

    Attributes
    ----------
    reading, filtered
        The newest reading, and what the low-passes make of it, shape (6,) [N, N m].

    """

    def __init__(
        self,
        config: SensorConfig,
        period: float,
        generator: np.random.Generator,
    ) -> None:
        self._generator, self._noise = generator, np.zeros((0, AXES))
        self._mounting = (
            np.array(config.mounting).reshape(3, 3) if config.mounting else None
        )
        self._axes: Records[Axis] = np.zeros(AXES, dtype=AXIS)
        self._axes['bias'] = config.bias
        self._axes['limit'] = config.full_scale if config.saturate else np.inf
        if config.noise:
            self._axes['noise_std'] = np.repeat(
                (config.force_noise_std, config.torque_noise_std), 3
            )
        if config.quantise:
            self._axes['quantum'] = converter_step(config)
        self._stages = np.zeros((0, 5))
        if config.low_pass:
            self._stages = low_pass_stages(config.low_pass_cutoff, 1.0 / period)
        self._memory = np.zeros((AXES, len(self._stages), 2))
        self._started = False
        self.reading: Vector = self._axes['reading']
        self.filtered: Vector = self._axes['filtered']

    def read(self, wrenches: Matrix) -> None:
        """Read true wrenches in the sensor's frame, one after another, shape (m, 6) [N, N m]."""
        if self._mounting is not None:
            wrenches = (wrenches.reshape(-1, 2, 3) @ self._mounting.T).reshape(-1, AXES)
        count = len(wrenches)
        if (
            len(self._noise) < count
        ):  # many at once: the generator is then seldom called
            self._noise = np.concatenate(
                (
                    self._noise,
                    self._generator.standard_normal((READINGS_DRAWN * count, AXES)),
                )
            )
        noise, self._noise = self._noise[:count], self._noise[count:]
        take_readings(
            wrenches, noise, self._axes, self._stages, self._memory, not self._started
        )
        self._started = True


def converter_step(config: SensorConfig) -> Vector:
    """Return one step of each axis: the range, both signs, over 2^bits, shape (6,)."""
    return np.asarray(2.0 * np.array(config.full_scale) / 2**config.bits)


def low_pass_stages(cutoff: float, rate: float) -> Matrix:
    """
    Return the chain of second-order Butterworth low-passes down to a cut-off.

    The stages lie at 500, 125, 31.25, ... Hz as far as they are above twice the cut-off [Hz] and
    below half the rate of the readings [Hz]; the last one lies at the cut-off. The gain there is
    -3.03 dB if the stage before it is four times as high, -3.01 dB without one. Returned are b0,
    b1, b2, a1, a2 of each, shape (stages, 5). Raises ConfigError if the cut-off is not below half
    the rate.
    """
    nyquist = 0.5 * rate
    if cutoff >= nyquist:
        raise ConfigError(
            'sensor.low_pass_cutoff',
            f'below half the rate of the substeps ({nyquist:g} Hz)',
            f'{cutoff:g} Hz',
        )
    corners = []
    corner = CASCADE_HIGHEST
    while corner > 2.0 * cutoff:
        if corner < nyquist:
            corners.append(corner)
        corner /= CASCADE_RATIO
    stages = [butterworth_low_pass(corner, rate) for corner in [*corners, cutoff]]
    return np.array([(*b, *a[1:]) for b, a in stages])


def butterworth_low_pass(cutoff: float, rate: float) -> tuple[Vector, Vector]:
    """
    Return numerator and denominator of a low-pass of second order, highest power of z first.

    To the last bit those of `scipy.signal.butter`, whose import takes a third of a run's start.
    """
    fs2 = 4.0  # twice the rate at which a Nyquist frequency is 1
    warped = fs2 * np.tan(0.5 * np.pi * (2.0 * cutoff / rate))
    poles = -warped * np.exp(0.5j * np.pi * np.array([-1, 1]) / 2)
    gain = warped**2 * np.real(1.0 / np.prod(fs2 - poles))
    return (
        gain * np.array([1.0, 2.0, 1.0]),
        np.real(np.poly((fs2 + poles) / (fs2 - poles))),
    )


@compiled
def take_readings(
    wrenches: Matrix,
    noise: Matrix,
    axes: Records[Axis],
    stages: Matrix,
    memory: Matrix,
    first: bool,
) -> None:
    """
    Take one reading after the other, the last one into `axes`, records of `AXIS`, shape (6,).

    Of true wrenches [N, N m] and white noise of deviation 1, shape (m, 6). The low-passes are of
    transposed direct form II, with a memory of shape (6, stages, 2), at rest at the `first` of all
    readings.
    """
    for i in range(axes.shape[0]):
        axis = axes[i]
        for k in range(wrenches.shape[0]):
            value = wrenches[k, i] + axis.bias + noise[k, i] * axis.noise_std
            value = min(max(value, -axis.limit), axis.limit)
            if axis.quantum > 0.0:
                value = axis.quantum * np.rint(value / axis.quantum)
            axis.reading = signal = value
            for stage in range(stages.shape[0]):
                b0, b1, b2, a1, a2 = stages[stage]
                kept = memory[i, stage]
                if first and k == 0:
                    kept[0], kept[1] = value * (1.0 - b0), value * (b2 - a2)
                output = b0 * signal + kept[0]
                kept[0] = b1 * signal - a1 * output + kept[1]
                kept[1] = b2 * signal - a2 * output
                signal = output
            axis.filtered = signal
