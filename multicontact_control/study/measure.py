"""What is measured in a run of a study, and the row of the table that it makes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
import math
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.judging.contact_metrics import LASTING_PUSH
from multicontact_control.judging.evidence import collect_evidence
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_modes import IN_PROCESS
from multicontact_control.judging.run_summary import summarise_run
from multicontact_control.runs.scenario import flatten_parameters, Setup
import numpy as np

END_TIME = 0.5  # s, the end of a run that tells whether it has settled
SETTLED = 0.1  # of the command: with a larger error at its end a run has not settled
SHORTEST = 2  # samples that a summary can be made of
AWAY = 0.05  # m, by which a surface moves away
# s, over which forces of a vanishing surface's neighbour are averaged.
MEAN_TIME = 0.012
IN_FULL = ('ticks', 'contacts', 'motion', 'torque', 'unstable_at_s')  # of summary.json
WINDOW_FIGURES = (  # of the evidence, by the window in which they are measured
    ('rest', 'rms_n'),
    ('moving', 'rms_n'),
    ('moving', 'lost'),
    ('rest', 'variance_n2'),
    ('moving', 'variance_n2'),
)
Metrics = Mapping[str, Any]


def measure_run(
    setup: Setup,
    supervised: bool,
    surface_gone: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """
    Run a setup in this process and measure it; an exception is its `error`, and ends no study.

    Parameters
    ----------
    setup
        What is run.
    supervised
        Whether contact states, watchdogs and limits are around the control law.
    surface_gone
        Between which times the last surface is away [s]; None if it stays.

    Returns
    -------
    dict
        What `metrics_row` takes, with the content of ``summary.json`` and the evidence that
        claims rest on.

    """
    from multicontact_control.runs.closed_loop import run_in_process

    try:
        result = run_in_process(
            setup, supervised=supervised, disturb=_move_surface(setup, surface_gone)
        )
        if result.data.ticks < SHORTEST:
            raise RunError(result.ended_early)
        run = RunMetrics(result.data, setup)
        events = None
        if supervised:
            events = result.events
        summary = summarise_run(
            run,
            mode=IN_PROCESS,
            timing={},
            ended_early=result.ended_early,
            events=events,
        )
        return {
            'summary': summary,
            'evidence': collect_evidence(run, summary),
            'final_error_share': _measure_final_error(run),
            'activity_nm': _measure_activity(run),
            'neighbour_n': _measure_neighbour_error(run, surface_gone),
            'error': None,
        }
    except Exception as problem:
        return {'summary': None, 'error': f'{type(problem).__name__}: {problem}'}


def _move_surface(
    setup: Setup, gone: tuple[float, float] | None
) -> Callable[[Any], None] | None:
    """Return what takes the last surface away and brings it back, None if it stays."""
    if gone is None:
        return None
    rate = setup.controller.rate
    last_surface = len(setup.controller.contact_names) - 1
    leaves, returns = gone
    moves = {round(leaves * rate): AWAY, round(returns * rate): -AWAY}

    def move_surface(loop: Any) -> None:
        if loop.tick in moves:
            loop.plant.contacts.shift_surface(last_surface, moves[loop.tick])

    return move_surface


def _measure_final_error(run: RunMetrics) -> float:
    """Return the largest force error of the last 0.5 s, relative to the task's command."""
    at_end = run.data.time > run.data.time[-1] - END_TIME
    desired = run.command[at_end]
    if not (desired > 0.0).all():
        return math.inf
    errors = np.abs(run.data.alpha_true[at_end] - desired)
    return float(np.max(errors / desired))


def _measure_activity(run: RunMetrics) -> float:
    """Return the rms change of torque per period of the joint with the largest [N m]."""
    window = run.windows.moving
    if not window.any():
        window = run.windows.loaded
    change = np.diff(run.data.torque, axis=0)[window[1:]]
    if len(change) == 0:
        return math.nan
    return float(np.sqrt((change * change).mean(axis=0)).max())


def _measure_neighbour_error(
    run: RunMetrics, gone: tuple[float, float] | None
) -> float | None:
    """Return the largest mean error over 12 ms of the first force around that time [N]."""
    if gone is None:
        return None
    leaves, returns = gone
    time = run.data.time
    count = round(MEAN_TIME * run.data.rate)
    error = run.contacts[0].error[(time >= leaves) & (time < returns + 1.0)]
    if len(error) < count:  # the run ended before
        return None
    means = np.convolve(error, np.full(count, 1.0 / count), 'valid')
    return float(np.abs(means).max())


def metrics_row(metrics: Metrics) -> dict[str, Any]:
    """
    Return what `measure_run` gave as flat columns, of the worst contact, step and push.

    `rest_...` and `moving_...` are without pushes; pushes are at rest, `short_push_s` and
    `lasting_push_s` the recovery from those of each length. A time is infinite if the event never
    came. Further numbers have dotted names as in ``summary.json``.
    """
    summary = metrics['summary'] or {}
    evidence = metrics.get('evidence') or {}
    ended_early = summary.get('ended_early')
    error_share = metrics.get('final_error_share')
    is_settled = error_share is not None and error_share <= SETTLED
    steps = []
    for contact in summary.get('contacts', {}).values():
        steps += contact['steps']
    contacts = list(evidence.get('contacts', {}).values())
    short_pushes = []
    lasting_pushes = []
    for contact in contacts:
        for push in contact['recoveries']:
            if push['moving']:
                continue
            if push['duration'] < LASTING_PUSH:
                short_pushes.append(push)
            else:
                lasting_pushes.append(push)
    pushes = short_pushes + lasting_pushes
    row = {
        'stable': bool(summary.get('stable', False)),
        'verdict': summary.get('verdict'),
        'error': metrics['error'] or ended_early,
        'instabilities': '; '.join(summary.get('instabilities', ())) or None,
        'settled': is_settled and not ended_early,
        'unstable_after_motion_s': evidence.get('unstable_after_motion_s'),
    }
    for window, figure in WINDOW_FIGURES:
        figures = [contact[window] for contact in contacts]
        row[f'{window}_{figure}'] = _find_largest(figures, figure)
    row |= {
        'push_peak_n': _find_largest(pushes, 'peak'),
        'push_off_s': _find_latest(pushes, 'recovery'),
        'short_push_s': _find_latest(short_pushes, 'recovery'),
        'lasting_push_s': _find_latest(lasting_pushes, 'recovery'),
        'rise_s': _find_latest(steps, 'rise_63_s'),
        'overshoot_percent': _find_largest(steps, 'overshoot_percent'),
        'activity_nm': metrics.get('activity_nm'),
        'neighbour_n': metrics.get('neighbour_n'),
    }
    in_full = {name: summary[name] for name in IN_FULL if name in summary}
    for name, value in flatten_parameters(in_full).items():
        if not isinstance(value, list):
            row[name] = value
    row['trajectory_sha256'] = summary.get('trajectory_sha256')
    return row


def _find_largest(records: Iterable[Metrics], name: str) -> float | None:
    """Return the largest of the values that are known, None if there is none."""
    values = []
    for record in records:
        if record[name] is not None:
            values.append(record[name])
    return max(values, default=None)


def _find_latest(records: Iterable[Metrics], name: str) -> float | None:
    """Return the largest time, infinite if an event never came, None if there are no times."""
    times = [record[name] for record in records]
    if None in times:
        return math.inf
    return max(times, default=None)
