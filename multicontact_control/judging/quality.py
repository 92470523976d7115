"""How good a run is: whether the answers to its steps and its motion are as designed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from multicontact_control.judging.metrics import RunMetrics

# Within these a run is as designed: the paper's claims, and a designed loop without overshoot.
SHORTEST_RISE = 0.6  # of the design, of every step up
LONGEST_RISE = 1.4
DESIGNED_OVERSHOOT = 10.0  # %
DESIGNED_STEADY_ERROR = 0.02  # of the step, in the steady state
DESIGNED_MOTION_ERROR = 0.005  # m rms


class Quality(NamedTuple):
    """
    One property of a run, in words with its number, and whether it is as designed.

    The bounds are the constants above: those of the paper's claims, where it makes one.
    """

    text: str
    as_designed: bool


def describe_quality(run: RunMetrics, motion_error: float | None) -> str:
    """
    Return in words how good a run is, first what is not as designed.

    A run can be stable and poor: this text tells why. `motion_error` is that of the window
    `moving` [m rms]; None if it is not known.
    """
    qualities = [*_judge_steps(run)]
    if motion_error is not None:
        text = f'motion error {1e3 * motion_error:.2g} mm rms'
        qualities.append(Quality(text, motion_error <= DESIGNED_MOTION_ERROR))
    parts = []
    for as_designed, heading in ((False, 'not as designed'), (True, 'as designed')):
        texts = [each.text for each in qualities if each.as_designed == as_designed]
        if texts:
            parts.append(f'{heading}: {", ".join(texts)}')
    return '; '.join(parts)


def _judge_steps(run: RunMetrics) -> Iterator[Quality]:
    """Yield rise, overshoot, settling and steady-state error of the steps of all contacts."""
    overshoots = []
    settling_times = []
    steady_errors = []
    within_design = True
    for contact in run.contacts:
        step = contact.largest_step
        if step is None:
            continue
        overshoots.append(step.overshoot_percent)
        if step.settling_s is not None:
            settling_times.append(step.settling_s)
        if step.steady_error_n is not None:
            error = abs(step.steady_error_n)
            steady_errors.append(error)
            within_design &= error <= DESIGNED_STEADY_ERROR * abs(step.size_n)
    if not overshoots:
        return
    yield from _judge_rise(run)
    largest_overshoot = max(overshoots)
    text = f'overshoot at most {largest_overshoot:.0f} %'
    yield Quality(text, largest_overshoot <= DESIGNED_OVERSHOOT)
    if len(settling_times) < len(overshoots):
        yield Quality('a step never settled', False)
    else:
        yield Quality(f'settled within {max(settling_times):.2f} s', True)
    if steady_errors:
        text = f'steady-state error at most {max(steady_errors):.2f} N'
        yield Quality(text, within_design)


def _judge_rise(run: RunMetrics) -> Iterator[Quality]:
    """Yield how fast the steps up of the paper's claims were, over the design."""
    rises: list[float] = []
    for contact in run.contacts:
        for step in contact.timed_steps:
            if step.rise_63_s is None:
                yield Quality('63 % of a step never reached', False)
                return
            rise = contact.rise_over_design(step)
            if rise is not None:
                rises.append(rise)
    if rises:
        slowest = max(rises)
        fastest = min(rises)
        ends = dict.fromkeys((f'{fastest:.2f}', f'{slowest:.2f}'))
        within_design = SHORTEST_RISE <= fastest and slowest <= LONGEST_RISE
        yield Quality(f'rise {" to ".join(ends)} of the design', within_design)
