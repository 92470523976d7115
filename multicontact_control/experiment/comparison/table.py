"""The tables that a comparison ends with: a line for each estimator."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

from multicontact_control.experiment.comparison.rows import grouped
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

CAPTION = ('fails: after the start of the motion; rest, move: rms error of the true force; lost: '
           'contact in motion; R [N²]; push: recovery [s]; torq: largest share of the limit')
COLUMNS = ('', 'stable', 'fails\n[s]', 'rest\n[N]', 'move\n[N]', 'lost\n[%]', 'R\nrest',
           'R\nmove', 'push\n.1 s', 'push\n1 s', 'torq\n[%]')
LEFT_OUT = (5, 6, 10)  # of them, where there is no room


def comparison_table(
    rows: Sequence[dict[str, Any]], plant: str, *, narrow: bool = False,
) -> Table:
    """
    Return the table of one plant: each estimator's median over the seeds, worse contact.

    Parameters
    ----------
    rows
        Of ``comparison.json``.
    plant
        Which of its plants.
    narrow
        Whether to leave some columns out, for terminals of 80 columns.

    """
    shown = [i for i in range(len(COLUMNS)) if not (narrow and i in LEFT_OUT)]
    table = Table(
        title=f'plant {plant}: worse contact, median over the seeds', box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0), pad_edge=False, caption=escape(CAPTION))
    for i in shown:
        table.add_column(escape(COLUMNS[i]), justify='right' if i else 'left', no_wrap=i > 0)
    last = ''
    for (where, kind, label), group in grouped(rows).items():
        if where != plant:
            continue
        if kind != last:
            table.add_section()
            table.add_row(f'[bold]{escape(kind)}[/bold]')
            last = kind
        cells = table_row(label, group)
        table.add_row(*(cells[i] for i in shown))
    return table


def table_row(label: str, group: Sequence[dict[str, Any]]) -> list[str]:
    """Return the cells of one line of the table."""
    stable = sum(row['stable'] for row in group)
    unstable = [row['unstable_after_motion_s'] for row in group
                if row['unstable_after_motion_s'] is not None]
    colour = 'green' if stable == len(group) else 'red'
    return [
        escape(label),
        f'[{colour}]{stable}/{len(group)}[/{colour}]',
        _range(unstable),
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
