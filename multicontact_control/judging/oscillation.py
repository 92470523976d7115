"""
Sustained oscillation of a force: how a limit cycle is told from noise and from transients.

The error of a force is cut into windows of 0.5 s, each half covered by the next, and looked at in
stretches of seven of them: 2 s. The *line* of a stretch is the frequency from 10 Hz up that is
strongest in its mean spectrum, with what is within 4 Hz of it. A stretch oscillates if

- the mean spectrum is at least 4 times as strong at the line as 6 Hz below it (of a slow drift it
  falls from lower frequencies on);
- in six of the seven windows the line holds at least half of the power from 10 Hz up (of noise and
  roughness 0.1 to 0.2);
- and in the same ones the rms of the line is at least 2.5 % of the command, and 0.1 N.
"""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.arrays import find_true_stretches, Mask, Matrix, Vector
import numpy as np
from scipy.signal import periodogram

WINDOW_TIME = 0.5  # s; five periods of the lowest frequency
LOWEST_LINE = 10.0  # Hz, just above the poles of the designed loop (8 Hz)
LINE_WIDTH = 4.0  # Hz to either side: the main lobe of a Hann window of 0.5 s
FLANK = 6.0  # Hz below a line, beyond that lobe
# Of the line over its flank. Noise whose power falls with frequency has at most 3 in 5 x 40 runs
# of 30 s.
LEAST_CONTRAST = 4.0
LEAST_LINE_SHARE = 0.5  # of the power from LOWEST_LINE up
LEAST_LINE_OF_COMMAND = 0.025  # rms over the command: 7 % from peak to peak
# Twice what the wrist sensor's noise is, so that a line can be known of.
LEAST_LINE_RMS = 0.1  # N
STRETCH = 7  # windows, 2 s; at twice the modelled stiffness a step has rung out in 1 s
EXCEPTIONS = 1  # windows of a stretch in which a supervisor may break the limit cycle
LONGEST_BRIDGE = 0.01  # s of missing samples to interpolate: a tenth of a slow period


class Oscillation(NamedTuple):
    """
    An episode in which a force oscillates.

    It is made of stretches of 2 s that follow each other, each of which oscillates by the three
    conditions above.
    """

    recognised_at: float  # when it had lasted for a stretch, 2 s [s]
    duration: float  # s
    frequency: float  # of its line, the median over its stretches [Hz]
    rms: float  # of its line, the median over its stretches [N]


class SpectralLine(NamedTuple):
    """
    The strongest line in the spectrum of one stretch of an error.

    Frequency and rms tell of an oscillation only if the stretch oscillates by it: every noise has
    a strongest line.
    """

    oscillates: bool
    frequency: float  # Hz
    rms: float  # N


def find_oscillations(
    error: Vector, command: Vector, judged: Mask, rate: float
) -> list[Oscillation]:
    """
    Return where a force oscillates, by the three conditions above.

    Parameters
    ----------
    error
        The force less its command, NaN where it is not known, shape (m,) [N].
    command
        What is asked for, shape (m,) [N].
    judged
        The samples to look at, shape (m,). Windows are left out that have others, lack more than
        10 ms, or have nothing asked for.
    rate
        Samples per second [Hz].

    Returns
    -------
    list of Oscillation
        The episodes in order of time; stretches that overlap are one.

    """
    length = round(WINDOW_TIME * rate)
    known = bridge_gaps(error, rate)
    usable = judged & np.isfinite(known) & (command > 0.0)
    starts = _list_window_starts(judged, usable, length)
    if len(starts) < STRETCH:
        return []
    index = np.array(starts)[:, None] + np.arange(length)
    largest_command = command[index].max(axis=1)
    limit = np.maximum(LEAST_LINE_OF_COMMAND * largest_command, LEAST_LINE_RMS)
    frequencies, density = periodogram(
        known[index], rate, np.hanning(length), detrend='linear'
    )
    power = density * frequencies[1]
    lines = []
    for begin in range(len(starts) - STRETCH + 1):
        stretch = slice(begin, begin + STRETCH)
        lines.append(_measure_line(frequencies, power[stretch], limit[stretch]))
    oscillates, frequency, rms = np.array(lines).T
    covered = np.convolve(oscillates, np.ones(STRETCH)) > 0.0
    episodes = []
    for begin, end in find_true_stretches(covered):
        inside = begin + np.flatnonzero(oscillates[begin:end])
        recognised = starts[begin + STRETCH - 1] + length - 1
        samples = starts[end - 1] + length - starts[begin]
        episodes.append(
            Oscillation(
                recognised / rate,
                samples / rate,
                float(np.median(frequency[inside])),
                float(np.median(rms[inside])),
            )
        )
    return episodes


def _list_window_starts(judged: Mask, usable: Mask, length: int) -> list[int]:
    """Return the first samples of the half-covering windows all of which can be used."""
    if not judged.any():
        return []
    starts = range(int(np.argmax(judged)), len(usable) - length + 1, length // 2)
    return [start for start in starts if usable[start : start + length].all()]


def _measure_line(frequencies: Vector, power: Matrix, limit: Vector) -> SpectralLine:
    """
    Return the line of a stretch.

    `power` has a row for each of the seven windows, shape (7, f) [N^2]; `limit` is the least rms
    of the line in each, shape (7,) [N].
    """
    band = frequencies >= LOWEST_LINE
    mean = power.mean(axis=0)
    peak = int(np.argmax(np.where(band, mean, 0.0)))
    near = np.abs(frequencies - frequencies[peak]) <= LINE_WIDTH + 1e-9
    line_power = (power * near).sum(axis=1)
    band_power = (power * (near | band)).sum(axis=1)
    dominates = line_power >= LEAST_LINE_SHARE * band_power
    is_strong = dominates & (np.sqrt(line_power) >= limit)
    flank = mean[peak - round(FLANK / frequencies[1])]
    stands_out = mean[peak] >= LEAST_CONTRAST * flank
    return SpectralLine(
        bool(stands_out and is_strong.sum() >= STRETCH - EXCEPTIONS),
        float(frequencies[peak]),
        float(np.sqrt(line_power.mean())),
    )


def bridge_gaps(values: Vector, rate: float) -> Vector:
    """
    Return a series whose gaps of at most 10 ms are interpolated, shape (m,).

    Longer gaps, and those at either end, stay NaN. `rate` is in samples per second [Hz].
    """
    missing = np.isnan(values)
    if not missing.any() or missing.all():
        return values
    samples = np.arange(len(values))
    filled = np.interp(samples, samples[~missing], values[~missing])
    for begin, end in find_true_stretches(missing):
        at_an_end = begin == 0 or end == len(values)
        if at_an_end or end - begin > LONGEST_BRIDGE * rate:
            filled[begin:end] = np.nan
    return filled
