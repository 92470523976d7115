"""What the runs of a sweep have in common: their medians over the seeds, a line each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.study.presets.sweep.plan import SweepPlan
from multicontact_control.experiment.study.table import Column, Line, Listing
import numpy as np
import pyarrow as pa

STABLE = 'stable'
EVERY = '*'
CHOICE = (
    STABLE, 'contacts.*.step_rise_63_s', 'contacts.*.rest.true_error_rms_n',
    'contacts.*.moving.true_error_rms_n')


def metric_values(table: pa.Table, name: str) -> Vector | None:
    """
    Return a metric of every run, shape (m,), NaN where a run has none.

    Parameters
    ----------
    table
        Of the sweep.
    name
        A column; with ``*`` the largest of all columns that fit.

    Returns
    -------
    Vector or None
        None if there is no such column of numbers.

    """
    head, star, tail = name.partition(EVERY)
    columns = [column for column in table.column_names if column == name or (
        star and column.startswith(head) and column.endswith(tail)
        and EVERY not in column and '.' not in column[len(head):len(column) - len(tail)])]
    series = []
    for column in columns:
        kind = table.schema.field(column).type
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)
                or pa.types.is_boolean(kind)):
            return None
        series.append([np.nan if value is None else float(value)
                       for value in table[column].to_pylist()])
    return np.fmax.reduce(np.array(series), axis=0) if series else None


def judged(table: pa.Table, name: str) -> Vector | None:
    """Return a metric of the stable runs, NaN for the others; `stable` itself of all."""
    values = metric_values(table, name)
    if values is None or name == STABLE:
        return values
    stable = metric_values(table, STABLE)
    return np.where(stable == 1.0, values, np.nan)


def chosen_metrics(table: pa.Table, wanted: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the metrics to show, and those that were wanted but are not there."""
    if wanted:
        missing = [name for name in wanted if metric_values(table, name) is None]
        return [name for name in wanted if name not in missing], missing
    return [name for name in CHOICE if (values := metric_values(table, name)) is not None
            and np.isfinite(values).any()], []


@dataclass(frozen=True)
class Group:
    """
    The runs that differ in their seeds only.

    Attributes
    ----------
    plant, values
        What they have in common.
    rows
        Their places in the table.

    """

    plant: str
    values: Mapping[str, Any]
    rows: tuple[int, ...]


def groups_of(plan: SweepPlan) -> list[Group]:
    """Return the groups of a plan, in its order."""
    rows: dict[tuple[str, str], list[int]] = {}
    for run in plan.runs:
        rows.setdefault((run.plant, run.job.overrides), []).append(run.number)
    return [Group(plant, plan.runs[numbers[0]].values, tuple(numbers))
            for (plant, _), numbers in rows.items()]


def middle(values: Vector) -> float:
    """Return the median of what is finite, NaN if nothing is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float('nan')


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
