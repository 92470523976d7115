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

WINDOW = 0.5  # s; five periods of the lowest frequency
LOWEST = 10.0  # Hz, just above the poles of the designed loop (8 Hz), which follows its command
LINE_WIDTH = 4.0  # Hz to either side: the main lobe of a Hann window of 0.5 s
FLANK = 6.0  # Hz below a line, beyond that lobe
CONTRAST = (
    4.0  # of noise whose power falls with frequency, at most 3 in 5 x 40 runs of 30 s
)
LINE_SHARE = 0.5  # of the power from LOWEST up
LARGEST_LINE = 0.025  # rms, of the command: 7 % from peak to peak
LEAST_LINE = (
    0.1  # N rms; twice what the wrist sensor's noise is, so that it can be known of
)
STRETCH = 7  # windows, 2 s; at twice the modelled stiffness a step has rung out in 1 s
EXCEPTIONS = (
    1  # windows of a stretch in which a supervisor may have broken the limit cycle
)
LONGEST_BRIDGE = (
    0.01  # s of missing samples that are interpolated; a tenth of the slowest period
)


class Oscillation(NamedTuple):
    """A stretch in which a force oscillates."""

    known: float  # when it had lasted 2 s [s]
    duration: float  # s
    frequency: float  # of its line [Hz]
    rms: float  # of its line [N]


def oscillations(
    error: Vector,
    command: Vector,
    judged: Mask,
    rate: float,
) -> list[Oscillation]:
    """
    Return where a force oscillates; see above.

    `error` is the force less its command, NaN where it is not known; both have shape (m,) [N].
    Windows that are not `judged`, lack more than 10 ms, or have nothing asked for are left out.
    """
    length = round(WINDOW * rate)
    known = bridged(error, rate)
    usable = judged & np.isfinite(known) & (command > 0.0)
    first = np.flatnonzero(judged)[0] if judged.any() else 0
    starts = [
        start
        for start in range(first, len(error) - length + 1, length // 2)
        if usable[start : start + length].all()
    ]
    if len(starts) < STRETCH:
        return []
    index = np.array(starts)[:, None] + np.arange(length)
    limit = np.maximum(LARGEST_LINE * command[index].max(axis=1), LEAST_LINE)
    frequencies, density = periodogram(
        known[index], rate, np.hanning(length), detrend='linear'
    )
    power = density * frequencies[1]
    oscillates, frequency, rms = np.array(
        [
            _line(
                frequencies,
                power[begin : begin + STRETCH],
                limit[begin : begin + STRETCH],
            )
            for begin in range(len(starts) - STRETCH + 1)
        ]
    ).T
    episodes = []
    for begin, end in find_true_stretches(
        np.convolve(oscillates, np.ones(STRETCH)) > 0.0
    ):
        inside = begin + np.flatnonzero(oscillates[begin:end])
        episodes.append(
            Oscillation(
                (starts[begin + STRETCH - 1] + length - 1) / rate,
                (starts[end - 1] + length - starts[begin]) / rate,
                float(np.median(frequency[inside])),
                float(np.median(rms[inside])),
            )
        )
    return episodes


def _line(
    frequencies: Vector, power: Matrix, limit: Vector
) -> tuple[bool, float, float]:
    """Return of the line of seven windows whether it oscillates, frequency [Hz] and rms [N]."""
    band, mean = frequencies >= LOWEST, power.mean(axis=0)
    peak = int(np.argmax(np.where(band, mean, 0.0)))
    near = np.abs(frequencies - frequencies[peak]) <= LINE_WIDTH + 1e-9
    line, all_of_it = ((power * part).sum(axis=1) for part in (near, near | band))
    strong = (line >= LINE_SHARE * all_of_it) & (np.sqrt(line) >= limit)
    stands_out = mean[peak] >= CONTRAST * mean[peak - round(FLANK / frequencies[1])]
    return (
        bool(stands_out and strong.sum() >= STRETCH - EXCEPTIONS),
        float(frequencies[peak]),
        float(np.sqrt(line.mean())),
    )


def bridged(values: Vector, rate: float) -> Vector:
    """Return a series with what is missing for at most 10 ms interpolated, shape (m,)."""
    missing = np.isnan(values)
    if not missing.any() or missing.all():
        return values
    places = np.arange(len(values))
    filled = np.interp(places, places[~missing], values[~missing])
    for begin, end in find_true_stretches(missing):
        outside = begin == 0 or end == len(values)
        if outside or end - begin > LONGEST_BRIDGE * rate:
            filled[begin:end] = np.nan
    return filled
