"""The verdict on a run: against limits, with what help of the supervisor, and how well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from multicontact_control.arrays import find_true_stretches
from multicontact_control.judging.limit_findings import list_findings
from multicontact_control.judging.metrics import describe_unknown_truth, RunMetrics
from multicontact_control.judging.quality import describe_quality
from multicontact_control.judging.run_modes import (
    EXTERNAL_RUN,
    IN_PROCESS,
    INTERRUPTED,
)
from multicontact_control.judging.supervisor_events import list_interventions, LogLine
from multicontact_control.runs.recording import describe_missing, Missing
import numpy as np

STABLE = 'stable'
POOR = 'poor'
HELD = 'held by the supervisor'
NOT_STABLE = 'not stable'
SILENT = 'ended: robot silent'
UNJUDGED = 'not judged'
# Whether the loop is known to be stable; of the other verdicts it is not known.
LOOP_IS_STABLE = {STABLE: True, POOR: True, HELD: False, NOT_STABLE: False}
BY_MEASUREMENT = 'by the measured forces'

# A run beyond these is stable, and poor: a force that goes twice as far as its largest step, and a
# motion that is off by twice what the paper's may be (`claims`), a tenth of its 0.1 m.
LARGEST_OVERSHOOT = 100.0  # %
LARGEST_MOTION_ERROR = 0.01  # m rms, while the commanded pose moves
# Share of the time under load for which every force of a stable run is known.
LEAST_KNOWN_SHARE = 0.5


class Verdict(NamedTuple):
    """
    What a run is called, and why.

    `docs/verdicts.md` says what each name means and which limits lead to it. `stable` of the
    summary is true, false or None by the name.
    """

    name: str  # `STABLE`, `POOR`, `HELD`, `NOT_STABLE`, `SILENT` or `UNJUDGED`
    reasons: tuple[str, ...]  # of a run that is not judged, what was seen all the same
    judged: str  # which forces, over what time
    quality: str  # how good the answers to steps and the motion are
    # Of the limits that were passed: the first that has a time [s], if any.
    unstable_at: float | None
    unjudged: str = ''  # why it is not judged, if it is not


def describe_verdict(summary: Mapping[str, Any]) -> str:
    """
    Return the verdict of a run and its reasons, as its ``summary.json`` has them.

    Terminal, report and figure titles have the same words. Where true forces are not known, they
    say that it is by measured ones.
    """
    text: str = summary['verdict']
    reasons = '; '.join(summary['instabilities'])
    if text == UNJUDGED:
        text = f'{text}: {summary["unjudged"]}'
        if reasons:
            text = f'{text}; seen: {reasons}'
        return text
    if summary['without_truth'] and text != SILENT:
        return f'{text} {BY_MEASUREMENT}: {reasons}'
    if reasons:
        text = f'{text}: {reasons}'
    return text


def judge_run(
    run: RunMetrics,
    *,
    mode: str = IN_PROCESS,
    ended_early: str = '',
    events: Sequence[LogLine] = (),
) -> Verdict:
    """
    Judge a run.

    Parameters
    ----------
    run
        The run with its metrics, and with what its recording lacks.
    mode
        That of ``summary.json``, one of `run_modes`.
    ended_early
        Why the run ended before its time; `INTERRUPTED` speaks neither for nor against it.
    events
        The lines of the supervisor's log with their times [s].

    """
    motion_error = run.summarise_motion()['moving_position_rms_m']
    findings = list_findings(run, mode, ended_early)
    interventions = list_interventions(run, events)
    shortcomings = _list_shortcomings(run, motion_error)
    robot_silent = mode == EXTERNAL_RUN and ended_early not in ('', INTERRUPTED)
    unjudged = ''
    # The silence of the robot is the first finding, and by itself no word on the loop.
    if len(findings) > int(robot_silent):
        name = NOT_STABLE
    elif robot_silent:
        name = SILENT
    elif interventions:
        name = HELD
    else:
        unjudged = _explain_unjudged(run, ended_early)
        if unjudged:
            name = UNJUDGED
        elif shortcomings:
            name = POOR
        else:
            name = STABLE
    times = [finding.time for finding in findings if finding.time is not None]
    texts = [finding.text for finding in findings]
    return Verdict(
        name=name,
        reasons=(*texts, *interventions, *shortcomings),
        judged=_describe_judged(run),
        quality=describe_quality(run, motion_error),
        unstable_at=min(times, default=None),
        unjudged=unjudged,
    )


def _list_shortcomings(run: RunMetrics, motion_error: float | None) -> list[str]:
    """Return what makes a stable run poor: large overshoots, and the motion's error [m]."""
    texts = []
    for contact in run.contacts:
        step = contact.largest_step
        if step is not None and step.overshoot_percent > LARGEST_OVERSHOOT:
            percent = f'{step.overshoot_percent:.0f} %'
            texts.append(f'{contact.name}: overshoots its largest step by {percent}')
    if motion_error is not None and motion_error > LARGEST_MOTION_ERROR:
        texts.append(f'motion error of {1e3 * motion_error:.0f} mm rms')
    return texts


def _describe_judged(run: RunMetrics) -> str:
    """Return what a verdict is about: forces, and their time under load."""
    names: dict[str, list[str]] = {'true': [], 'measured': []}
    for contact in run.contacts:
        if (contact.normal_command > 0.0).any():
            if contact.has_truth:
                names['true'].append(contact.name)
            else:
                names['measured'].append(contact.name)
    parts = [f'{run.windows.loaded.sum() / run.data.rate:.3g} s under load']
    for kind, contacts in names.items():
        if contacts:
            parts.append(f'{kind} force of {" and ".join(contacts)}')
    return ', '.join(parts)


def _explain_unjudged(run: RunMetrics, ended_early: str) -> str:
    """Return why a run that passed no limit is not called stable; empty if it is."""
    if ended_early == INTERRUPTED:
        return INTERRUPTED
    if run.missing:
        return f'{describe_missing(run.missing)}; what is there passed no limit'
    if not np.isfinite(run.force).any():
        return 'neither true nor measured forces'
    if not run.windows.loaded.any():
        return 'never under load'
    for contact in run.contacts:
        known = run.find_known_share(contact.column, contact.force)
        if known < LEAST_KNOWN_SHARE:
            return (
                f'{contact.name}: its force could be judged for {100.0 * known:.0f} % of '
                'the time under load'
            )
        unknown = find_true_stretches(contact.pressed & contact.unknown)
        if unknown:
            gaps = []
            for begin, end in unknown:
                begin_time = float(run.data.time[begin])
                gaps.append(Missing(begin_time, end / run.data.rate))
            text = describe_missing(gaps, 'force')
            return f'{contact.name}: {text}; what is there passed no limit'
    without_truth = run.list_without_truth()
    unknown_truth = describe_unknown_truth(without_truth, run.data.contact_names)
    if unknown_truth:
        return f'{unknown_truth}; {BY_MEASUREMENT} no limit was passed'
    return ''
