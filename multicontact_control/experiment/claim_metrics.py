"""What claims and comparisons rest on beyond ``summary.json``: answers to steps and pushes, R."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from multicontact_control.arrays import Mask, Vector
from multicontact_control.config import ForceConfig
from multicontact_control.experiment.judge import HELD
from multicontact_control.experiment.metrics import (
    force_error,
    lost_share,
    mean_in,
    median_in,
    motion_start,
    motion_summary,
    next_event,
    rms_in,
    SETTLE_AFTER_START,
    step_responses,
    torque_summary,
    value_in,
    windows,
)
from multicontact_control.experiment.oscillation import spectrum
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.scenario import Setup
import numpy as np
from scipy.optimize import brentq

AFTER_PUSH = 0.5  # s, in which the estimate of R is watched for a reaction
BAND_OF_COMMAND = 0.05  # recovered: the error is within this share of the command ...
BAND_OF_NOISE = 3.0  # ... or this many standard deviations of the error before the push,
BAND_HELD = 0.1  # s, for this long
LOOK_BACK = 1.0  # s, before a push, from which its noise is taken
LASTING = 0.5  # s; a push this long is to be controlled out while it lasts
GROWTH = 0.5  # s before instability in which its oscillation is looked for
SETTLE_AFTER_PUSH = 1.0  # s, left out of `rest` and `moving`


def designed_rise(force: ForceConfig) -> float:
    """
    Return the time in which the designed loop reaches 63 % of a step [s].

    T_d plus the time at which the response of the two poles reaches 1 - 1/e: for two equal ones
    2.146 time constants. T_d is that of the input alone: this is about the true force, of which
    the sensor's low-pass delays the measurement only.
    """
    tau, ratio = force.time_constant, force.second_pole_ratio

    def missing(t: float) -> float:
        if abs(ratio - 1.0) < 1e-6:
            return (1.0 + t) * math.exp(-t) - math.exp(-1.0)
        return (ratio * math.exp(-t) - math.exp(-ratio * t)) / (ratio - 1.0) - math.exp(-1.0)

    return float(force.input_delay + tau * brentq(missing, 0.0, 10.0))


def evidence_of(data: RunData, setup: Setup, summary: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return what the claims rest on, as JSON values.

    Parameters
    ----------
    data, setup
        The run.
    summary
        What `summarise` says of it.

    """
    start = motion_start(setup)
    return {
        'scenario': setup.scenario.name, 'plant': setup.plant_name, 'seed': setup.seed,
        'drives': setup.plant.drives, 'estimator': setup.noise_estimator.estimator,
        'active_state_order': setup.controller.force.active_state_order,
        'damping_rate': setup.controller.force.damping_rate,
        'input_delay_s': setup.controller.force.input_delay,
        'designed_rise_s': designed_rise(setup.controller.force),
        **{name: summary[name] for name in (
            'verdict', 'instabilities', 'unjudged', 'unstable_at_s', 'kept_real_time')},
        # What the supervisor holds tells nothing of what the law alone would do.
        'stable': None if summary['verdict'] == HELD else summary['stable'],
        'unstable_after_motion_s': _after_motion(setup, summary['unstable_at_s']),
        'ran_in_motion': float(data.time[-1]) > start + SETTLE_AFTER_START,
        # The paper speaks of normal forces; couples may well be 0, or of either sign.
        'contacts': {data.contact_names[i]: _contact_evidence(data, setup, i)
                     for i in setup.controller.leaders},
        'motion': motion_summary(data, setup), 'torque': torque_summary(data, setup)}


def _after_motion(setup: Setup, unstable_at: float | None) -> float | None:
    start = motion_start(setup)
    return None if unstable_at is None or start == math.inf else unstable_at - start


def _contact_evidence(data: RunData, setup: Setup, i: int) -> dict[str, Any]:
    rest, moving = quiet_windows(data, setup)
    error, command = force_error(data, setup, i), setup.commanded(data.time)[:, i]
    variance = data.noise_variance[:, i]
    steps = [step for step in step_responses(data, setup, i) if step.size > 0.0]
    ratios = [setup.plant.stiffness_of(column.name) / column.stiffness
              for column in setup.controller.columns if column.leader == i]
    start = motion_start(setup)
    return {
        'stiffness_ratio': max(ratios, key=lambda ratio: abs(ratio - 1.0)),
        'variance_rest_n2': median_in(rest, variance),
        'variance_moving_n2': median_in(moving, variance),
        'rises_s': [step.rise_63 for step in steps],
        'overshoot_percent': max((step.overshoot_percent for step in steps), default=None),
        'rest_command_n': median_in(rest, command),
        'rest_mean_error_n': mean_in(rest, error), 'rest_std_n': value_in(rest, error, np.std),
        'moving_command_n': median_in(moving, command),
        'moving_rms_n': rms_in(moving, error),
        'moving_lost': lost_share(data, setup, i, moving),
        'start_peak_n': value_in(
            (data.time >= start) & (data.time - start < SETTLE_AFTER_START), np.abs(error),
            np.max),
        'variance_peak_n2': value_in(_pushed_at_rest(data, setup), variance, np.max)}


def _pushed_at_rest(data: RunData, setup: Setup) -> Mask:
    """Return the samples of the pushes at rest and of 0.5 s after each."""
    until = motion_start(setup)
    mask = np.zeros(data.ticks, dtype=bool)
    for start, duration in _pushes(setup):
        if start < until:
            end = min(start + duration + AFTER_PUSH, until)
            mask |= (data.time >= start) & (data.time < end)
    return mask


def _pushes(setup: Setup) -> list[tuple[float, float]]:
    """Return start and duration of the plant's pushes [s]."""
    return list(zip(setup.plant.push_start, setup.plant.push_duration))


def quiet_windows(data: RunData, setup: Setup) -> tuple[Mask, Mask]:
    """Return the windows `rest` and `moving` without the pushes and 1 s after each."""
    judged = windows(setup.scenario.reference, data.time)
    quiet = np.ones(data.ticks, dtype=bool)
    for start, duration in _pushes(setup):
        quiet &= ~_between(data.time, start, start + duration + SETTLE_AFTER_PUSH)
    return judged.rest & quiet, judged.moving & quiet


def disturbance_summary(
    data: RunData, setup: Setup, unstable_at: float | None,
) -> dict[str, Any]:
    """
    Return what `compare` needs beyond ``summary.json``, as JSON values.

    Parameters
    ----------
    data, setup
        The run.
    unstable_at
        As in ``summary.json`` [s].

    """
    rest, moving = quiet_windows(data, setup)
    contacts = {name: {
        'rest': _errors(data, setup, i, rest), 'moving': _errors(data, setup, i, moving),
        'recoveries': recoveries(data, setup, i, unstable_at)}
        for i, name in enumerate(data.contact_names)}
    return {
        'contacts': contacts, 'unstable_at_s': unstable_at,
        'oscillation_hz': None if unstable_at is None else growing_line(data, unstable_at),
        'unstable_after_motion_s': _after_motion(setup, unstable_at)}


def _errors(
    data: RunData, setup: Setup, contact: int, window: Mask,
) -> dict[str, float | None]:
    error = force_error(data, setup, contact)
    return {'rms_n': rms_in(window, error), 'mean_n': mean_in(window, error),
            'std_n': value_in(window, error, np.std),
            'lost': lost_share(data, setup, contact, window),
            'variance_n2': median_in(window, data.noise_variance[:, contact])}


def recoveries(
    data: RunData, setup: Setup, contact: int, unstable_at: float | None = None,
) -> list[dict[str, Any]]:
    """
    Return the answers of one contact to the pushes of the plant.

    Parameters
    ----------
    data, setup
        The run.
    contact
        Its column.
    unstable_at
        As in ``summary.json`` [s].

    Returns
    -------
    list of dict
        `start` and `duration` of the push [s], whether it comes `moving`; the largest error of
        the true force until the next event, `peak` [N]; the error that counts as recovered,
        `band` [N]; `recovery`, the time until the error is within the band and stays there for
        0.1 s [s]: from the end of a short push, from the start of a lasting one (0.5 s or more).
        0 if it never left the band, None if it did not come back before the next event, or the
        run was unstable by then.

    """
    last = float(data.time[-1])
    error, command = force_error(data, setup, contact), setup.commanded(data.time)[:, contact]
    found = []
    for start, duration in _pushes(setup):
        lasting = duration >= LASTING
        from_time = start if lasting else start + duration
        until = min(next_event(setup, start), last + 1.0 / data.rate,
                    start + duration if lasting else math.inf)
        before = _between(data.time, start - LOOK_BACK, start)
        judged = _between(data.time, from_time, until)
        if not (before.any() and judged.any()):
            continue
        band = max(BAND_OF_COMMAND * float(command[judged][0]),
                   BAND_OF_NOISE * float(np.std(error[before])))
        after = _settled(np.abs(error[judged]) <= band, round(BAND_HELD * data.rate))
        # The end of a run that ended before its time takes no recovery back.
        lost = unstable_at is not None and unstable_at < min(until, last)
        found.append({
            'start': start, 'duration': duration, 'moving': start >= motion_start(setup),
            'peak': float(np.nanmax(np.abs(error[_between(data.time, start, until)]))),
            'band': band, 'recovery': None if after is None or lost else after / data.rate})
    return found


def _between(time: Vector, start: float, end: float) -> Mask:
    return (time >= start - 1e-9) & (time < end - 1e-9)


def _settled(inside: Mask, held: int) -> int | None:
    """Return the first sample from which the next `held` are inside; None if there is none."""
    if len(inside) < held:
        return None
    counts = np.convolve(inside.astype(int), np.ones(held, dtype=int), 'valid')
    first = np.flatnonzero(counts == held)
    return int(first[0]) if first.size else None


def growing_line(data: RunData, unstable_at: float) -> float | None:
    """Return the strongest frequency of the true forces over the 0.5 s before that [Hz]."""
    window = _between(data.time, unstable_at - GROWTH, unstable_at)
    forces = data.alpha_true[window]
    if forces.shape[0] < GROWTH * data.rate - 1 or not np.isfinite(forces).all():
        return None
    frequencies, power = spectrum(forces.T, data.rate, padding=8)
    return float(frequencies[int(np.argmax(power.sum(axis=0)))])
