"""What a simulated run shows of the paper's claims, as values that a study can tabulate."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from multicontact_control.judging.contact_metrics import (
    ContactMetrics,
    designed_rise,
)
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_series import (
    rms_within,
    SETTLE_AFTER_START,
    statistic_within,
)
from multicontact_control.judging.verdict import HELD
import numpy as np

AFTER_PUSH = 0.5  # s, in which the estimate of R is watched for a reaction

# Of a run, as from `collect_evidence`, or of one of its contacts.
Evidence = Mapping[str, Any]


def collect_evidence(run: RunMetrics, summary: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return what studies tabulate and claims rest on, of a simulated run, as JSON values.

    Parameters
    ----------
    run
        The run with its metrics.
    summary
        The content of its ``summary.json``.

    Returns
    -------
    dict
        Of the run: what it was made with (`plant`, `seed`, `estimator`, `active_state_order`,
        `damping_rate`), the designed rise time [s], whether it is stable (None if the supervisor
        held it), when it became unstable after the start of the motion [s], whether it ran in
        motion, and errors of the motion; and `contacts`, the evidence of each.

    """
    setup = run.setup
    force = setup.controller.force
    unstable_at = summary['unstable_at_s']
    unstable_after_motion = None
    if unstable_at is not None and not math.isinf(run.motion_start):
        unstable_after_motion = unstable_at - run.motion_start
    contacts = {}
    for contact in run.contacts:
        evidence = _collect_contact_evidence(contact)
        evidence['recoveries'] = contact.measure_recoveries(unstable_at)
        steps = summary['contacts'][contact.name]['steps']
        steps_up = [step for step in steps if step['size_n'] > 0.0]
        evidence['rises_s'] = [step['rise_63_s'] for step in steps_up]
        contacts[contact.name] = evidence
    stable = summary['stable']
    if summary['verdict'] == HELD:
        # What the supervisor holds tells nothing of what the law alone would do.
        stable = None
    end = float(run.data.time[-1])
    return {
        'plant': setup.plant_name,
        'seed': setup.seed,
        'estimator': setup.noise_estimator.estimator,
        'active_state_order': force.active_state_order,
        'damping_rate': force.damping_rate,
        'designed_rise_s': designed_rise(force),
        'stable': stable,
        'unstable_after_motion_s': unstable_after_motion,
        'ran_in_motion': end > run.motion_start + SETTLE_AFTER_START,
        'contacts': contacts,
        'motion': summary['motion'],
    }


def _collect_contact_evidence(contact: ContactMetrics) -> dict[str, Any]:
    """Return the evidence of one contact that needs no summary."""
    run = contact.run
    start = run.motion_start
    evidence: dict[str, Any] = {}
    for name, window in run.quiet_windows.items():
        evidence[name] = {
            'command_n': statistic_within(window, contact.command, np.median),
            'rms_n': rms_within(window, contact.error),
            'mean_n': statistic_within(window, contact.error),
            'std_n': statistic_within(window, contact.error, np.std),
            'lost': contact.find_lost_share(window),
            'variance_n2': statistic_within(window, contact.noise_variance, np.median),
        }
    starting = run.between(start, start + SETTLE_AFTER_START)
    pushed = np.zeros(run.data.ticks, dtype=bool)
    for push in run.pushes:
        watched_until = push.start + push.duration + AFTER_PUSH
        pushed |= run.between(push.start, min(watched_until, start))
    evidence['stiffness_ratio'] = _find_stiffness_ratio(contact)
    size = np.abs(contact.error)
    evidence['start_peak_n'] = statistic_within(starting, size, np.max)
    variance_peak = statistic_within(pushed, contact.noise_variance, np.max)
    evidence['variance_peak_n2'] = variance_peak
    return evidence


def _find_stiffness_ratio(contact: ContactMetrics) -> float | None:
    """Return true over modelled stiffness of a contact, that farthest from 1; None of a couple."""
    setup = contact.run.setup
    farthest = None
    for column in setup.controller.columns:
        if column.leader == contact.column:
            ratio = setup.plant.stiffness_of(column.name) / column.stiffness
            if farthest is None or abs(ratio - 1.0) > abs(farthest - 1.0):
                farthest = ratio
    return farthest
