"""What is measured in a run of a study, and the row of the table that it makes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.judging.contact_metrics import LASTING_PUSH
from multicontact_control.judging.evidence import collect_evidence
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_summary import summarise_run
from multicontact_control.runs.scenario import flatten_parameters, Setup
import numpy as np

LAST = 0.5  # s, the end of a run that tells whether it has settled
SETTLED = 0.1  # of the command: with a larger error at its end a run has not settled
SHORTEST = 2  # samples that a summary can be made of
AWAY = 0.05  # m, by which a surface moves away
MEAN_TIME = (
    0.012  # s, over which forces of a vanishing surface's neighbour are averaged
)
IN_FULL = ('ticks', 'contacts', 'motion', 'torque', 'unstable_at_s')  # of summary.json
Metrics = Mapping[str, Any]


def measure_run(
    setup: Setup,
    supervised: bool,
    surface_gone: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """
    Run a setup in this process and measure it; an exception is its `error`, and ends no study.

    The last surface is away between the two times of `surface_gone` [s], if given. Returns what
    `metrics_row` takes, with the content of ``summary.json`` and the evidence that claims rest on.
    """
    from multicontact_control.runs.closed_loop import run_in_process

    try:
        result = run_in_process(
            setup, supervised=supervised, disturb=_disturbance(setup, surface_gone)
        )
        if result.data.ticks < SHORTEST:
            raise RunError(result.ended_early)
        data, run = result.data, RunMetrics(result.data, setup)
        summary = summarise_run(
            data,
            setup,
            mode='in_process',
            timing={},
            ended_early=result.ended_early,
            events=result.events if supervised else None,
        )
        return {
            'summary': summary,
            'evidence': collect_evidence(data, setup, summary),
            'final_error_share': _final_error_share(run),
            'activity_nm': _activity(run),
            'neighbour_n': _neighbour_error(run, surface_gone),
            'error': None,
        }
    except Exception as problem:
        return {'summary': None, 'error': f'{type(problem).__name__}: {problem}'}


def _disturbance(setup: Setup, gone: tuple[float, float] | None) -> Any:
    """Return what takes the last surface away and brings it back, None if it stays."""
    if gone is None:
        return None
    rate, last = setup.controller.rate, len(setup.controller.contact_names) - 1
    moves = dict(zip((round(time * rate) for time in gone), (AWAY, -AWAY)))

    def disturb(loop: Any) -> None:
        if loop.tick in moves:
            loop.plant.contacts.shift_surface(last, moves[loop.tick])

    return disturb


def _final_error_share(run: RunMetrics) -> float:
    """Return the largest force error of the last 0.5 s, relative to the task's command."""
    last = run.data.time > run.data.time[-1] - LAST
    desired = run.command[last]
    if not (desired > 0.0).all():
        return math.inf
    return float(np.max(np.abs(run.data.alpha_true[last] - desired) / desired))


def _activity(run: RunMetrics) -> float:
    """Return the rms change of torque per period of the joint with the largest [N m]."""
    window = run.windows.moving if run.windows.moving.any() else run.windows.loaded
    change = np.diff(run.data.torque, axis=0)[window[1:]]
    return (
        float(np.sqrt((change * change).mean(axis=0)).max())
        if len(change)
        else math.nan
    )


def _neighbour_error(run: RunMetrics, gone: tuple[float, float] | None) -> float | None:
    """Return the largest mean error over 12 ms of the first force around that time [N]."""
    if gone is None:
        return None
    time, count = run.data.time, round(MEAN_TIME * run.data.rate)
    error = run.contacts[0].error[(time >= gone[0]) & (time < gone[1] + 1.0)]
    if len(error) < count:  # the run ended before
        return None
    return float(np.abs(np.convolve(error, np.full(count, 1.0 / count), 'valid')).max())


def metrics_row(metrics: Metrics) -> dict[str, Any]:
    """
    Return what `measure_run` gave as flat columns, of the worst contact, step and push.

    `rest_...` and `moving_...` are without pushes; pushes are at rest, `short_push_s` and
    `lasting_push_s` the recovery from those of each length. A time is infinite if the event never
    came. Further numbers have dotted names as in ``summary.json``.
    """
    summary, evidence = metrics['summary'] or {}, metrics.get('evidence') or {}
    ended, share = summary.get('ended_early'), metrics.get('final_error_share')
    contacts = summary.get('contacts', {}).values()
    steps = [step for contact in contacts for step in contact['steps']]
    shown = evidence.get('contacts', {}).values()
    pushes = [
        push
        for contact in shown
        for push in contact['recoveries']
        if not push['moving']
    ]
    return {
        'stable': bool(summary.get('stable', False)),
        'verdict': summary.get('verdict'),
        'error': metrics['error'] or ended,
        'instabilities': '; '.join(summary.get('instabilities', ())) or None,
        'settled': share is not None and share <= SETTLED and not ended,
        'unstable_after_motion_s': evidence.get('unstable_after_motion_s'),
        **{
            f'{window}_{name}': _largest(contact[window][name] for contact in shown)
            for window, name in (
                ('rest', 'rms_n'),
                ('moving', 'rms_n'),
                ('moving', 'lost'),
                ('rest', 'variance_n2'),
                ('moving', 'variance_n2'),
            )
        },
        'push_peak_n': _largest(push['peak'] for push in pushes),
        'push_off_s': _latest(push['recovery'] for push in pushes),
        'short_push_s': _latest(
            push['recovery'] for push in pushes if push['duration'] < LASTING_PUSH
        ),
        'lasting_push_s': _latest(
            push['recovery'] for push in pushes if push['duration'] >= LASTING_PUSH
        ),
        'rise_s': _latest(step['rise_63_s'] for step in steps),
        'overshoot_percent': _largest(step['overshoot_percent'] for step in steps),
        **{name: metrics.get(name) for name in ('activity_nm', 'neighbour_n')},
        **{
            name: value
            for name, value in flatten_parameters(
                {name: summary[name] for name in IN_FULL if name in summary}
            ).items()
            if not isinstance(value, list)
        },
        'trajectory_sha256': summary.get('trajectory_sha256'),
    }


def _largest(values: Iterable[float | None]) -> float | None:
    """Return the largest of the values that are known, None if there is none."""
    return max((value for value in values if value is not None), default=None)


def _latest(times: Iterable[float | None]) -> float | None:
    """Return the largest time, infinite if an event never came, None if there are no times."""
    return _largest(math.inf if time is None else time for time in times)
