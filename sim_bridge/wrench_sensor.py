"""The wrist force/torque sensor: from the true wrench to readings, after a JR3."""

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
HIGHEST_CUTOFF = 500.0  # Hz
CASCADE_RATIO = 4.0
AXES = 6
READINGS_DRAWN = 16  # noise is drawn for so many times the readings of one call


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
    A sensor that takes one reading per integration step.

    Reading = quantise(saturate(mounting true + bias + noise)). The low-passes work on the
    readings, as the instrument's own signal processor does, and start from the first one.

    Parameters
    ----------
    config
        Which of these effects there are, and how large.
    period
        Time between readings, the integration step [s].
    generator
        Random numbers of the noise.

    Attributes
    ----------
    reading, filtered
        The newest reading, and what the low-passes make of it, shape (6,) [N, N m].

    Raises
    ------
    ConfigError
        If the cut-off of the low-passes is not below half the rate of the readings.

    """

    def __init__(
        self,
        config: SensorConfig,
        period: float,
        generator: np.random.Generator,
    ) -> None:
        self._generator = generator
        self._noise = np.zeros((0, AXES))
        self._mounting: Matrix | None = None
        if config.mounting:
            self._mounting = np.array(config.mounting).reshape(3, 3)
        self._axes: Records[Axis] = np.zeros(AXES, dtype=AXIS)
        self._axes['bias'] = config.bias
        self._axes['limit'] = np.inf
        if config.saturate:
            self._axes['limit'] = config.full_scale
        if config.noise:
            stds = (config.force_noise_std, config.torque_noise_std)
            self._axes['noise_std'] = np.repeat(stds, 3)
        if config.quantise:
            self._axes['quantum'] = converter_step(config)
        self._stages = np.zeros((0, 5))
        if config.low_pass:
            self._stages = low_pass_stages(config.low_pass_cutoff, 1.0 / period)
        self._memory = np.zeros((AXES, len(self._stages), 2))
        self._started = False
        self.reading: Vector = self._axes['reading']
        self.filtered: Vector = self._axes['filtered']

    def read_wrenches(self, wrenches: Matrix) -> None:
        """
        Take a reading of each of some true wrenches, one after another.

        They are in the sensor's frame, shape (m, 6) [N, N m].
        """
        if self._mounting is not None:
            wrenches = (wrenches.reshape(-1, 2, 3) @ self._mounting.T).reshape(-1, AXES)
        noise = self._take_noise(len(wrenches))
        take_readings(
            wrenches, noise, self._axes, self._stages, self._memory, not self._started
        )
        self._started = True

    def _take_noise(self, count: int) -> Matrix:
        """Return white noise for some readings; it is drawn for many at once, which is faster."""
        if len(self._noise) < count:
            drawn = self._generator.standard_normal((READINGS_DRAWN * count, AXES))
            self._noise = np.concatenate((self._noise, drawn))
        noise = self._noise[:count]
        self._noise = self._noise[count:]
        return noise


def converter_step(config: SensorConfig) -> Vector:
    """
    Return the size of a step of the analog-digital converter on each axis, shape (6,) [N, N m].

    It is the range, both signs, over 2^bits.
    """
    return np.asarray(2.0 * np.array(config.full_scale) / 2**config.bits)


def low_pass_stages(cutoff: float, rate: float) -> Matrix:
    """
    Return the chain of second-order Butterworth low-passes down to a cut-off.

    The stages lie at 500, 125, 31.25, ... Hz as far as they are above twice the cut-off and below
    half the rate; the last one lies at the cut-off. The gain there is -3.03 dB if the stage before
    it is four times as high, -3.01 dB without one.

    Parameters
    ----------
    cutoff
        Of the last stage [Hz].
    rate
        Of the readings [Hz].

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
            'sensor.low_pass_cutoff',
            f'below half the rate of the substeps ({nyquist:g} Hz)',
            f'{cutoff:g} Hz',
        )
    stages = []
    corner = HIGHEST_CUTOFF
    while corner > 2.0 * cutoff:
        if corner < nyquist:
            stages.append(butterworth_low_pass(corner, rate))
        corner /= CASCADE_RATIO
    stages.append(butterworth_low_pass(cutoff, rate))
    return np.array([(*b, *a[1:]) for b, a in stages])


def butterworth_low_pass(cutoff: float, rate: float) -> tuple[Vector, Vector]:
    """
    Return numerator b and denominator a of a low-pass of second order, highest power of z first.

    Of a cut-off and a rate of readings [Hz], shape (3,) each. To the last bit those of
    `scipy.signal.butter`, whose import takes a third of a run's start.
    """
    fs2 = 4.0  # twice the rate at which a Nyquist frequency is 1
    warped = fs2 * np.tan(0.5 * np.pi * (2.0 * cutoff / rate))
    poles = -warped * np.exp(0.5j * np.pi * np.array([-1, 1]) / 2)
    gain = warped**2 * np.real(1.0 / np.prod(fs2 - poles))
    numerator = gain * np.array([1.0, 2.0, 1.0])
    denominator = np.real(np.poly((fs2 + poles) / (fs2 - poles)))
    return numerator, denominator


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
    Take one reading after the other, the last of them into `axes`.

    The low-passes are of transposed direct form II.

    Parameters
    ----------
    wrenches
        True wrenches as mounted, shape (m, 6) [N, N m].
    noise
        White noise of deviation 1, shape (m, 6).
    axes
        Records of `AXIS`, shape (6,).
    stages
        Of the low-passes, see `low_pass_stages`.
    memory
        Of the low-passes, shape (6, stages, 2).
    first
        Whether the first of these wrenches is the first of all: the low-passes then start at rest
        at its reading.

    """
    for i in range(axes.shape[0]):
        axis = axes[i]
        for k in range(wrenches.shape[0]):
            value = wrenches[k, i] + axis.bias + noise[k, i] * axis.noise_std
            value = min(max(value, -axis.limit), axis.limit)
            if axis.quantum > 0.0:
                value = axis.quantum * np.rint(value / axis.quantum)
            axis.reading = value
            signal = value
            for stage in range(stages.shape[0]):
                b0, b1, b2, a1, a2 = stages[stage]
                kept = memory[i, stage]
                if first and k == 0:
                    kept[0] = value * (1.0 - b0)
                    kept[1] = value * (b2 - a2)
                output = b0 * signal + kept[0]
                kept[0] = b1 * signal - a1 * output + kept[1]
                kept[1] = b2 * signal - a2 * output
                signal = output
            axis.filtered = signal
