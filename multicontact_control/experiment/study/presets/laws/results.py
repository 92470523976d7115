"""What came of a race of force laws: a line for each, and what each is good for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import math
from statistics import median
from typing import Any, NamedTuple

from multicontact_control.experiment.study.presets.laws.jobs import (
    DELAY,
    FRICTION,
    STIFFNESS,
    TASK,
    VANISHING,
)
from multicontact_control.experiment.study.table import Column, Line, Listing

NEAR_BEST = 1.25  # times the best figure, that counts as about as good
FAR_FROM_BEST = 3.0
LEAST = {'rest_rms_n': 0.02, 'neighbour_n': 0.2, 'push_off_s': 0.01, 'overshoot_percent': 3.0}
COLUMNS = (
    Column('law', number=False), Column('stable', number=False),
    Column('rest rms [N]', 'rest\n[N]'), Column('moving rms [N]', 'move\n[N]'),
    Column('rise of a step [ms]', 'rise\n[ms]'), Column('overshoot [%]', 'over\n[%]'),
    Column('push of 5 N: peak [N]', 'push\n[N]'),
    Column('off for [ms]', 'off\n[ms]'), Column('torque activity [N m]', 'torque\n[N m]'),
    Column('neighbour of a vanishing surface [N]', 'gone\n[N]', spare=True),
    Column('true/modelled stiffness', 'k', number=False),
    Column('delay [periods]', 'delay', number=False),
    Column('joint friction x', 'friction', number=False))
CAPTION = ('medians over the seeds, of the worse contact. k, delay, friction: values at which the '
           'run was stable, in brackets those without an oscillation or another limit cycle only')

Row = Mapping[str, Any]


class Figure(NamedTuple):
    """A figure by which laws are ranked: smaller is better."""

    name: str
    text: str
    unit: str
    digits: int
    scale: float


FIGURES = (
    Figure('rest_rms_n', 'error at rest', 'N', 2, 1.0),
    Figure('moving_rms_n', 'error while sliding', 'N', 2, 1.0),
    Figure('rise_s', 'quick steps', 'ms', 0, 1e3),
    Figure('overshoot_percent', 'steps without overshoot', '%', 0, 1.0),
    Figure('push_peak_n', 'pushes', 'N', 1, 1.0),
    Figure('activity_nm', 'smooth torque', 'N m', 2, 1.0),
    Figure('neighbour_n', 'a surface that vanishes', 'N', 1, 1.0))


def law_rows(jobs: Sequence[Any], results: Callable[[Any], Mapping[str, Any]]) -> list[Row]:
    """Return one row for each law on each plant, the content of ``laws.json``."""
    rows: list[Row] = []
    for preset, plant in dict.fromkeys((job.preset, job.plant) for job in jobs):
        runs = [(job, results(job)) for job in jobs if (job.preset, job.plant) == (preset, plant)]
        task = [metrics for job, metrics in runs if job.situation == TASK]
        gone = [metrics['neighbour_n'] for job, metrics in runs if job.situation == VANISHING]
        rows.append({
            'law': preset, 'plant': plant,
            'stable': sum(bool(metrics['stable']) for metrics in task), 'runs': len(task),
            'rest_rms_n': _worst(task, lambda c: c['rest_rms_n']),
            'moving_rms_n': _worst(task, lambda c: c['moving_rms_n']),
            'rise_s': _worst(task, lambda c: _largest(step['rise_s'] for step in c['steps'])),
            'overshoot_percent': _worst(task, lambda c: _largest(
                step['overshoot_percent'] for step in c['steps'])),
            'push_peak_n': _worst(task, lambda c: c['push_peak_n']),
            'push_off_s': _worst(task, lambda c: c['push_off_s']),
            'activity_nm': _median(metrics['activity_nm'] for metrics in task),
            'neighbour_n': _median(gone),
            **{situation: _survived(runs, situation)
               for situation in (STIFFNESS, DELAY, FRICTION)}})
    return rows


def _largest(values: Iterable[float | None]) -> float | None:
    known = list(values)
    return None if not known or None in known else max(known)  # type: ignore[type-var]


def _median(values: Iterable[float | None]) -> float | None:
    """Return the median, None if it is one of those that are not known."""
    ordered = [math.inf if value is None else value for value in values]
    middle = median(ordered) if ordered else math.inf
    return None if math.isinf(middle) else middle


def _worst(runs: Sequence[Row], figure: Callable[[Row], float | None]) -> float | None:
    """Return the median over runs of a figure of the worse contact."""
    return _median(_largest(figure(contact) for contact in metrics['contacts'].values())
                   for metrics in runs)


def _survived(runs: Sequence[tuple[Any, Row]], situation: str) -> list[dict[str, Any]]:
    """Return for each value how many runs were stable, and how many did not oscillate."""
    found: dict[float, list[Row]] = {}
    for job, metrics in runs:
        if job.situation == situation:
            found.setdefault(job.value, []).append(metrics)
    return [{'value': value, 'runs': len(group),
             'stable': sum(bool(metrics['stable']) for metrics in group),
             'calm': sum(not metrics['oscillates'] for metrics in group)}
            for value, group in sorted(found.items())]


def law_listing(rows: Sequence[Row], plant: str) -> Listing:
    """Return the table of one plant."""
    lines = []
    for row in rows:
        if row['plant'] != plant:
            continue
        cells = [row['law'], f'{row["stable"]}/{row["runs"]}', _text(row['rest_rms_n'], 2),
                 _text(row['moving_rms_n'], 2), _text(row['rise_s'], 0, 1e3),
                 _text(row['overshoot_percent'], 0), _text(row['push_peak_n'], 1),
                 _text(row['push_off_s'], 0, 1e3), _text(row['activity_nm'], 2),
                 _text(row['neighbour_n'], 1)]
        cells += [_values(row[situation]) for situation in (STIFFNESS, DELAY, FRICTION)]
        lines.append(Line(cells, _able(row)))
    return Listing(COLUMNS, lines, caption=CAPTION)


def _able(row: Row) -> bool:
    """Return whether a law was stable in every run of the task, of which some were not lost."""
    return bool(row['runs'] and row['stable'] == row['runs'])


def _text(value: float | None, digits: int, scale: float = 1.0) -> str:
    return '-' if value is None else f'{scale * value:.{digits}f}'


def _values(survived: Sequence[Row]) -> str:
    """Return the values at which all runs were stable, with those that were only calm."""
    if not survived:
        return '-'
    parts = []
    for each in survived:
        text = f'{each["value"]:g}'
        if each['stable'] == each['runs']:
            parts.append(text)
        elif each['calm'] == each['runs']:
            parts.append(f'({text})')
    return ' '.join(parts) or 'none'


def law_findings(rows: Sequence[Row]) -> list[str]:
    """Return in plain sentences what each law is good for, on each plant."""
    said = []
    for plant in dict.fromkeys(row['plant'] for row in rows):
        here = [row for row in rows if row['plant'] == plant]
        able = [row for row in here if _able(row)]
        for row in here:
            if not row['runs']:
                continue
            if row not in able:
                said.append(f'{plant}, {row["law"]}: not stable in '
                            f'{row["runs"] - row["stable"]} of {row["runs"]} runs of the task.')
                continue
            good, bad = [], []
            for figure in FIGURES:
                values = [each[figure.name] for each in able if each[figure.name] is not None]
                if not values:
                    continue
                value, floor = row[figure.name], LEAST.get(figure.name, 0.0)
                best = max(min(values), floor)
                if value is None or value > FAR_FROM_BEST * best:
                    bad.append(f'{figure.text} ({_text(value, figure.digits, figure.scale)} '
                               f'{figure.unit})')
                elif value <= NEAR_BEST * best:
                    good.append(figure.text)
            said.append(f'{plant}, {row["law"]}: good at {", ".join(good) or "nothing above all"}'
                        + (f'; not at {", ".join(bad)}' if bad else '') + '.')
    return said
