"""The table over the seeds of a sweep: a line for each combination."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from multicontact_control.experiment.study.presets.sweep.groups import (
    groups_of,
    judged,
    middle,
    STABLE,
)
from multicontact_control.experiment.study.presets.sweep.plan import SweepPlan
from multicontact_control.experiment.study.table import Column, Line, Listing
import numpy as np
import pyarrow as pa


def sweep_listing(plan: SweepPlan, table: pa.Table, metrics: Sequence[str]) -> Listing:
    """
    Return how many runs of each combination were stable, and the medians of those.

    Parameters
    ----------
    plan, table
        Of the sweep.
    metrics
        A column each.

    """
    names = [name for name in metrics if name != STABLE]
    series = {name: judged(table, name) for name in [STABLE, *names]}
    head = ['plant', *plan.units, STABLE, *names]
    lines = []
    for group in groups_of(plan):
        rows = list(group.rows)
        cells = [group.plant, *(_text(group.values[name]) for name in plan.units)]
        stable = series[STABLE]
        count = 0 if stable is None else int(stable[rows].sum())
        cells.append(f'{count}/{len(rows)}')
        for name in names:
            values = series[name]
            cells.append(_text(middle(values[rows]) if values is not None else np.nan))
        lines.append(Line(cells))
    columns = [Column(name, short, number=i > len(plan.units))
               for i, (name, short) in enumerate(zip(head, short_names(head)))]
    return Listing(columns, lines)


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
