"""The numbers of one run that the paper's claims rest on."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from multicontact_control.arrays import Mask
from multicontact_control.config import ForceConfig
from multicontact_control.experiment.disturbances import quiet_windows
from multicontact_control.experiment.metrics import (
    motion_summary,
    SETTLE_AFTER_START,
    step_responses,
    torque_summary,
)
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.scenario import Setup
import numpy as np
from scipy.optimize import brentq

AFTER_PUSH = 0.5  # s, in which the estimate of R is watched for a reaction


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
    data
        The recording.
    setup
        Its configuration.
    summary
        What `summarise` says of it.

    """
    motion = setup.scenario.reference.motion
    unstable_at = summary['unstable_at_s']
    start = motion.start_time if motion else None
    return {
        'scenario': setup.scenario.name, 'plant': setup.plant_name, 'seed': setup.seed,
        'drives': setup.plant.drives, 'estimator': setup.noise_estimator.estimator,
        'active_state_order': setup.controller.force.active_state_order,
        'input_delay_s': setup.controller.force.input_delay,
        'designed_rise_s': designed_rise(setup.controller.force),
        **{name: summary[name] for name in (
            'stable', 'verdict', 'instabilities', 'unstable_at_s', 'kept_real_time')},
        'unstable_after_motion_s':
            None if unstable_at is None or start is None else unstable_at - start,
        'ran_in_motion': start is not None and float(data.time[-1]) > start + SETTLE_AFTER_START,
        'contacts': {name: _contact(data, setup, i)
                     for i, name in enumerate(data.contact_names)},
        'motion': motion_summary(data, setup), 'torque': torque_summary(data, setup)}


def _contact(data: RunData, setup: Setup, i: int) -> dict[str, Any]:
    name = data.contact_names[i]
    rest, moving = quiet_windows(data, setup)
    error = data.alpha_true[:, i] - data.alpha_des[:, i]
    variance = data.noise_variance[:, i]
    steps = [step for step in step_responses(data, setup, i) if step.size > 0.0]
    true_stiffness = setup.plant.surfaces[name].stiffness
    return {
        'stiffness_ratio': true_stiffness / setup.controller.contacts[name].stiffness,
        'variance_rest_n2': _median(variance, rest),
        'variance_moving_n2': _median(variance, moving),
        'rises_s': [step.rise_63 for step in steps],
        'overshoot_percent': max((step.overshoot_percent for step in steps), default=None),
        'rest_command_n': _median(data.alpha_des[:, i], rest),
        'rest_mean_error_n': _mean(error, rest), 'rest_std_n': _std(error, rest),
        'moving_command_n': _median(data.alpha_des[:, i], moving),
        'moving_rms_n': _mean(error ** 2, moving, root=True),
        'moving_lost': _mean((data.alpha_true[:, i] <= 0.0).astype(float), moving),
        'start_peak_n': _largest(np.abs(error), _start(data, setup)),
        'variance_peak_n2': _largest(variance, _pushed_at_rest(data, setup))}


def _start(data: RunData, setup: Setup) -> Mask:
    """Return the samples of the first 2 s of the motion."""
    motion = setup.scenario.reference.motion
    if motion is None:
        return np.zeros(data.ticks, dtype=bool)
    since = data.time - motion.start_time
    return (since >= 0.0) & (since < SETTLE_AFTER_START)


def _pushed_at_rest(data: RunData, setup: Setup) -> Mask:
    """Return the samples of the pushes at rest and of 0.5 s after each."""
    motion = setup.scenario.reference.motion
    until = motion.start_time if motion else math.inf
    mask = np.zeros(data.ticks, dtype=bool)
    for start, duration in zip(setup.plant.push_start, setup.plant.push_duration):
        if start < until:
            end = min(start + duration + AFTER_PUSH, until)
            mask |= (data.time >= start) & (data.time < end)
    return mask


def _known(values: Any, window: Mask) -> Any:
    chosen = values[window]
    return chosen[np.isfinite(chosen)]


def _median(values: Any, window: Mask) -> float | None:
    known = _known(values, window)
    return float(np.median(known)) if known.size else None


def _mean(values: Any, window: Mask, *, root: bool = False) -> float | None:
    known = _known(values, window)
    if not known.size:
        return None
    mean = float(np.mean(known))
    return math.sqrt(mean) if root else mean


def _std(values: Any, window: Mask) -> float | None:
    known = _known(values, window)
    return float(np.std(known)) if known.size else None


def _largest(values: Any, window: Mask) -> float | None:
    known = _known(values, window)
    return float(np.max(known)) if known.size else None
