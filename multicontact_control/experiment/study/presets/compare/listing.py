"""The table that a comparison ends with: a line for each estimator."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

from multicontact_control.experiment.study.presets.compare.rows import grouped
from multicontact_control.experiment.study.table import Column, Line, Listing

CAPTION = ('fails: after the start of the motion; rest, move: rms error of the true force; lost: '
           'contact in motion; R [N²]; push: recovery [s]; torq: largest share of the limit')
COLUMNS = (
    Column('estimator', '', number=False), Column('stable'),
    Column('unstable after motion start [s]', 'fails\n[s]'),
    Column('rest rms [N]', 'rest\n[N]'), Column('moving rms [N]', 'move\n[N]'),
    Column('contact lost moving [%]', 'lost\n[%]', spare=True),
    Column('R rest [N²]', 'R\nrest', spare=True), Column('R moving [N²]', 'R\nmove'),
    Column('recovery, push 0.1 s [s]', 'push\n.1 s'),
    Column('recovery, push 1 s [s]', 'push\n1 s'),
    Column('torque [% of limit]', 'torq\n[%]', spare=True))


def comparison_listing(rows: Sequence[dict[str, Any]], plant: str) -> Listing:
    """
    Return the table of one plant: each estimator's median over the seeds, worse contact.

    Parameters
    ----------
    rows
        Of ``comparison.json``.
    plant
        Which of its plants.

    """
    lines: list[Line] = []
    for (where, kind, label), group in grouped(rows).items():
        if where == plant:
            keys = ' '.join(row['key'] for row in group)
            lines.append(Line(
                _cells(label, group), all(row['stable'] for row in group), kind,
                f'class="choice{"" if lines else " first"}" data-keys="{keys}"'))
    return Listing(COLUMNS, lines, caption=CAPTION)


def _cells(label: str, group: Sequence[dict[str, Any]]) -> list[str]:
    """Return the cells of one line of the table."""
    stable = sum(row['stable'] for row in group)
    unstable = [row['unstable_after_motion_s'] for row in group
                if row['unstable_after_motion_s'] is not None]
    return [
        label, f'{stable}/{len(group)}', _range(unstable),
        _middle(group, 'rest_rms_n', 3), _middle(group, 'moving_rms_n', 2),
        _middle(group, 'moving_lost', 2, 100.0), _middle(group, 'rest_variance_n2', 2),
        _middle(group, 'moving_variance_n2', 1), _push(group, False), _push(group, True),
        _middle(group, 'torque_max_fraction', 0, 100.0)]


def _range(values: Sequence[float]) -> str:
    """Return the smallest and the largest of some times after the start of the motion."""
    if not values:
        return ''
    known = [value for value in values if value >= 0.0]
    texts = ['rest'] if len(known) < len(values) else []
    texts += list(dict.fromkeys(f'{value:.1f}' for value in (min(known), max(known)))
                  ) if known else []
    return '-'.join(texts)


def _middle(group: Sequence[dict[str, Any]], name: str, digits: int, factor: float = 1.0) -> str:
    values = [row[name] for row in group if row[name] is not None]
    return f'{factor * median(values):.{digits}f}' if values else '-'


def _push(group: Sequence[dict[str, Any]], lasting: bool) -> str:
    times = [push['recovery_s'] for row in group for push in row['pushes']
             if not push['moving'] and (push['duration_s'] >= 0.5) == lasting]
    if not times:
        return '-'
    middle = median(float('inf') if value is None else value for value in times)
    return 'never' if middle == float('inf') else f'{middle:.3f}'
