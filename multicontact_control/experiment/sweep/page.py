"""``sweep.html``: the picture of a sweep and its table over the seeds, and the same in words."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from multicontact_control.experiment.html import image, write_page
from multicontact_control.experiment.html import table as html_table
from multicontact_control.experiment.sweep.figure import draw_sweep
from multicontact_control.experiment.sweep.groups import groups_of, judged, middle, STABLE
from multicontact_control.experiment.sweep.plan import SweepPlan
import numpy as np
import pyarrow as pa
from rich.box import SIMPLE_HEAD
from rich.markup import escape as plain
from rich.table import Table

FIGURE_FILE = 'sweep.png'
PAGE_FILE = 'sweep.html'
LONGEST = 1000  # lines of the page's table
NOTE = ('Every line stands for the runs that differ in their seed only: how many were stable, and '
        'the median of the stable ones; a star is the worst contact. Every single run is in '
        'sweep.parquet.')


def group_lines(
    plan: SweepPlan, table: pa.Table, metrics: Sequence[str],
) -> tuple[list[str], list[list[str]]]:
    """Return head and lines of the table over the seeds."""
    names = [name for name in metrics if name != STABLE]
    series = {name: judged(table, name) for name in [STABLE, *names]}
    head = ['plant', *plan.units, STABLE, *names]
    lines = []
    for group in groups_of(plan):
        rows = list(group.rows)
        line = [group.plant, *(_text(group.values[name]) for name in plan.units)]
        stable = series[STABLE]
        count = 0 if stable is None else int(stable[rows].sum())
        line.append(f'{count}/{len(rows)}')
        for name in names:
            values = series[name]
            line.append(_text(middle(values[rows]) if values is not None else np.nan))
        lines.append(line)
    return head, lines


def short_names(names: Sequence[str]) -> list[str]:
    """Return the last parts of dotted names, as many as it takes to tell them apart."""
    short = []
    for name in names:
        parts = name.split('.')
        count = next(n for n in range(1, len(parts) + 1) if n == len(parts) or sum(
            other.split('.')[-n:] == parts[-n:] for other in names) == 1)
        short.append('.'.join(parts[-count:]))
    return short


def _text(value: Any) -> str:
    if value is None or value != value:
        return '-'
    return f'{value:.4g}' if isinstance(value, float) else str(value)


def group_table(plan: SweepPlan, table: pa.Table, metrics: Sequence[str]) -> Table:
    """Return the table over the seeds for the terminal."""
    head, lines = group_lines(plan, table, metrics)
    shown = Table(title=f'{plan.study.name}: stable runs and their medians over the seeds',
                  box=SIMPLE_HEAD)
    for i, name in enumerate(short_names(head)):
        shown.add_column(plain(name), overflow='fold',
                         justify='right' if i > len(plan.units) else 'left')
    for line in lines:
        shown.add_row(*map(plain, line))
    return shown


def write_sweep_page(
    plan: SweepPlan, table: pa.Table, metrics: Sequence[str], folder: Path,
) -> list[Path]:
    """Draw the picture and write the page; return their files."""
    png = folder / FIGURE_FILE
    draw_sweep(plan, table, metrics).savefig(png, dpi=130)
    head, lines = group_lines(plan, table, metrics)
    study = plan.study
    parts = [f'<p>{escape(study.description)}</p>',
             f'<p>{len(plan.runs)} runs of the scenario {escape(study.scenario)}, '
             f'{len(study.seeds)} with each combination.</p>',
             image(png, f'The metrics of {study.name}'), f'<p class=note>{NOTE}</p>',
             html_table([escape(name) for name in head],
                        [[escape(cell) for cell in line] for line in lines[:LONGEST]],
                        numbers_from=1 + len(plan.units))]
    if len(lines) > LONGEST:
        parts.append(f'<p class=note>{len(lines) - LONGEST} more lines are left out.</p>')
    page = folder / PAGE_FILE
    write_page(page, f'Sweep {study.name}', '\n'.join(parts))
    return [png, page]
