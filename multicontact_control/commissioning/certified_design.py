"""The fastest force loop that is certified for what a user asks for."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

from joblib import delayed, Parallel
from multicontact_control.commissioning.certified_region import (
    CertifiedLoop,
    FIRST_FACTOR,
    LAST_FACTOR,
    split_delays,
)
from multicontact_control.errors import ConfigError
from multicontact_control.force.loop_family import Range
import numpy as np

# What is tried, the fastest first: time constants [s], K_2 [1/s].
CANDIDATES = {
    'time_constant': np.geomspace(0.01, 0.16, 13).round(4).tolist(),
    'damping_rate': np.geomspace(200.0, 5.0, 13).round(1).tolist(),
}


class CertifiedDesign(NamedTuple):
    """The fastest candidate whose region contains what was asked for."""

    value: float  # of the parameter: s or 1/s
    decay_rate: float  # the slowest that is certified [1/s]
    loop: CertifiedLoop


def design_certified(
    parameter: str,
    make_loop: Callable[[float], CertifiedLoop],
    stiffness: Range,
    delay: Range,
    report: Callable[[str], None],
    jobs: int,
) -> CertifiedDesign:
    """
    Return the first of the `CANDIDATES` with which all surfaces and delays are certified.

    Parameters
    ----------
    parameter
        Of `force`: a key of `CANDIDATES`.
    make_loop
        Of a value of the parameter, its loop.
    stiffness, delay
        What is asked for [N/m], [s].
    report
        Is told what was tried, a line each.
    jobs
        How many boxes are certified at once, 0 for as many as there are cores.

    Raises
    ------
    ConfigError
        If none of those tried is certified.

    """
    values = CANDIDATES[parameter]
    for value in values:
        loop = make_loop(value)
        rate = _certify_all(loop, stiffness, delay, jobs)
        if rate > 0.0:
            return CertifiedDesign(value, rate, loop)
        report(f'{parameter} {value:g}: not certified')
    raise ConfigError(
        'stiffness',
        f'a range that a {parameter} from {values[0]:g} to {values[-1]:g} is certified on',
        f'{stiffness[0]:g} to {stiffness[1]:g} N/m',
    )


def _certify_all(
    loop: CertifiedLoop, stiffness: Range, delay: Range, jobs: int
) -> float:
    """Return the slowest decay certified on ranges of stiffness and delay, or 0 if not all is."""
    count = math.ceil(math.log(stiffness[1] / stiffness[0]) / math.log(FIRST_FACTOR))
    edges = np.geomspace(*stiffness, max(count, 1) + 1).tolist()
    # Long delays and stiff surfaces first, where loops mostly fail.
    tasks = (
        delayed(_certify_box)(loop, (low, high), strip)
        for strip in reversed(split_delays(delay, loop.model.period))
        for low, high in reversed(list(zip(edges[:-1], edges[1:])))
    )
    slowest = math.inf
    for rate in Parallel(jobs or -1, return_as='generator')(tasks):
        slowest = min(slowest, rate)
        if slowest == 0.0:
            break
    return slowest


def _certify_box(loop: CertifiedLoop, stiffness: Range, delay: Range) -> float:
    """
    Return the slowest decay certified on a box, or 0 if not all of it is.

    A box that is refused is quartered, until its stiffness is within a factor of 1.07.
    """
    certificate = loop.certify(stiffness, delay)
    if certificate is not None:
        return certificate.decay_rate(loop.model.period)
    low, high = stiffness
    if high / low < LAST_FACTOR**2:
        return 0.0
    middle_stiffness = math.sqrt(low * high)
    middle_delay = 0.5 * (delay[0] + delay[1])
    slowest = math.inf
    for part in ((middle_delay, delay[1]), (delay[0], middle_delay)):
        for surfaces in ((middle_stiffness, high), (low, middle_stiffness)):
            slowest = min(slowest, _certify_box(loop, surfaces, part))
            if slowest == 0.0:
                return 0.0
    return slowest


def describe_certified(
    parameter: str, found: CertifiedDesign, own: float, own_loop: CertifiedLoop
) -> str:
    """Return a certified design and what it costs beside a preset's own, as lines of text."""
    gain, own_gain = (
        loop.stiffness * loop.model.observer.feedback[0]
        for loop in (found.loop, own_loop)
    )
    return f"""{parameter:19} {found.value:g}, the preset has {own:g}
certified decay     {found.decay_rate:.3g} 1/s or faster
loop gain k L_1     {gain:.3g} 1/s^2, {gain / own_gain:.2f} of the preset's"""
