"""Series made small enough to be part of a page, which unpacks them: page_assets/figures.js."""

from __future__ import annotations

import base64
from collections.abc import Sequence
import math
from typing import Any
import zlib

from multicontact_control.arrays import Codes, Vector
import numpy as np

LEVELS = 4096  # that the middle 99 % of a series are told apart by, at least
MIDDLE = (0.5, 99.5)  # %
TIME_STEP = 1e-4  # s
UNKNOWN = -1 << 31  # the code of what is not known
LARGEST_CODE = 1 << 29
LIMIT = 1e100  # beyond which values are cut off: their differences shall be finite


def pack(time: Vector, series: Sequence[Vector], *, logarithmic: bool = False) -> dict[str, Any]:
    """
    Pack series that have their times in common.

    Values become multiples of a step, those of a logarithmic axis by their logarithm; what is
    packed are the differences of neighbours, byte by byte, as zlib has it.

    Parameters
    ----------
    time
        Not decreasing, shape (m,) [s]; kept to 0.1 ms.
    series
        Each of shape (m,); kept to 1/4096 of what the middle 99 % of it span, or finer.
    logarithmic
        Whether only what is positive is known, and is kept by its logarithm to base 10.

    Returns
    -------
    dict
        JSON values: `length` m, `steps` and `logarithmic` of time and every series, `data`.

    """
    codes: list[Codes] = [np.rint(np.asarray(time, dtype=np.float64) / TIME_STEP).astype(np.int64)]
    steps = [TIME_STEP]
    for values in series:
        step, found = _codes(np.asarray(values, dtype=np.float64), logarithmic)
        codes.append(found)
        steps.append(step)
    planes = b''.join(map(_planes, codes))
    return {'length': len(time), 'steps': steps,
            'logarithmic': [False, *[logarithmic] * len(series)],
            'data': base64.b64encode(zlib.compress(planes, 9)).decode()}


def _codes(values: Vector, logarithmic: bool) -> tuple[float, Codes]:
    """Return the step of a series and its values in steps."""
    known = np.isfinite(values)
    if logarithmic:
        known &= values > 0.0
    scaled = np.clip(values[known], -LIMIT, LIMIT)
    if logarithmic:
        scaled = np.log10(scaled)
    step = _step(scaled)
    codes: Codes = np.full(len(values), UNKNOWN, dtype=np.int64)
    codes[known] = np.rint(scaled / step)
    return step, codes


def _step(values: Vector) -> float:
    """Return a power of two."""
    if not len(values):
        return 1.0
    low, high = np.percentile(values, MIDDLE)
    largest = float(np.abs(values).max())
    span = float(high - low) or float(np.ptp(values)) or largest
    return math.ldexp(1.0, math.floor(math.log2(max(
        span / LEVELS, largest / LARGEST_CODE, 1.0 / LIMIT))))


def _planes(codes: Codes) -> bytes:
    """Return differences as unsigned numbers, small ones small, their low bytes first."""
    change = np.diff(codes, prepend=0).astype(np.int32)  # modulo 2^32
    zigzag = ((change << 1) ^ (change >> 31)).astype('<i4')
    return zigzag.view(np.uint8).reshape(-1, 4).T.tobytes()


def envelope(
    time: Vector, series: Sequence[Vector], longest: int,
) -> tuple[Vector, list[Vector], int]:
    """
    Return series as they are, or thinned out such that every peak is still in them.

    Parameters
    ----------
    time, series
        Each of shape (m,).
    longest
        Samples that are left at most, even.

    Returns
    -------
    tuple
        Times and series, and of how many samples each stretch has been left its smallest and its
        largest value, in their order; 1 if nothing is left out. What is not finite is left out
        where anything else is known of the stretch.

    """
    size = -(-2 * len(time) // longest)
    if size <= 2:
        return time, list(series), 1
    starts = np.arange(0, len(time), size)
    ends = np.minimum(starts + size, len(time))
    middles = (starts + ends) // 2
    return (np.stack([time[starts], time[middles]], axis=1).ravel(),
            [_extremes(values, size) for values in series], size)


def _extremes(values: Vector, size: int) -> Vector:
    """Return the smallest and the largest value of every `size` samples, in their order."""
    filled = np.full(-(-len(values) // size) * size, np.nan)
    filled[:len(values)] = values
    rows = filled.reshape(-1, size)
    known = np.isfinite(rows)
    places = np.stack([np.argmin(np.where(known, rows, np.inf), axis=1),
                       np.argmax(np.where(known, rows, -np.inf), axis=1)], axis=1)
    found: Vector = np.take_along_axis(
        np.where(known, rows, np.nan), np.sort(places, axis=1), axis=1).ravel()
    return found
