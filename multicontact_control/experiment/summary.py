"""``summary.json``: the numbers of a run, and what they are called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from multicontact_control.experiment.judge import (
    judge,
    MEASURED,
    read_event,
    STABLE,
    TRUE,
    UNKNOWN,
)
from multicontact_control.experiment.metrics import (
    contact_summary,
    judged_force,
    motion_summary,
    torque_summary,
    without_truth,
)
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.scenario import Setup
import numpy as np


def summarise(
    data: RunData, setup: Setup, *, mode: str, timing: Mapping[str, Any], ended_early: str = '',
    events: Sequence[tuple[float, str]] | None = None,
) -> dict[str, Any]:
    """
    Return the content of ``summary.json`` (schema 1).

    `mode` is ``in_process``, ``lockstep``, ``real_time``, ``external`` or ``recorded``; `timing`
    has deadline misses, tick times and latencies. `ended_early` is as for `judge`. `events` of the
    supervisor are times [s] and what changed; None if there was no supervisor.
    """
    # What the supervisor did after the run is not part of it.
    told = [(time, what) for time, what in events or () if time < data.ticks / data.rate]
    verdict = judge(data, setup, mode=mode, timing=timing, ended_early=ended_early,
                    events=[read_event(*event) for event in told])
    without = without_truth(data, setup)
    truth = bool(data.contact_names) and not without
    known = MEASURED if np.isfinite(judged_force(data, setup)).any() else UNKNOWN
    return {
        'schema': 1, 'scenario': setup.scenario.name, 'plant': setup.plant_name,
        'noise_estimator': setup.noise_estimator.estimator, 'mode': mode, 'seed': setup.seed,
        'ticks': data.ticks, 'rate_hz': data.rate,
        'trajectory_sha256': data.trajectory_sha256(), 'timing': timing,
        'contacts': {name: contact_summary(data, setup, i)
                     for i, name in enumerate(data.contact_names)},
        'motion': motion_summary(data, setup), 'torque': torque_summary(data, setup),
        'stable': None if verdict.unjudged else verdict.name == STABLE,
        'verdict': verdict.name, 'unjudged': verdict.unjudged or None,
        'instabilities': list(verdict.reasons), 'unstable_at_s': verdict.unstable_at,
        'ended_early': ended_early or None, 'kept_real_time': verdict.kept_real_time, 'claims': [],
        'truth': truth, 'without_truth': without, 'forces': TRUE if truth else known,
        'commanded_by_topic': setup.commanded_by_topic,
        'supervised': events is not None} | (
            {} if events is None else {'events': [
                {'time_s': round(time, 6), 'what': what} for time, what in told]})
