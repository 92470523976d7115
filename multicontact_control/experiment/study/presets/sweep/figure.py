"""The picture of a sweep: metrics against its first parameter, grouped by its second."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from multicontact_control.arrays import Vector
from multicontact_control.experiment.study.presets.sweep.groups import judged, STABLE
from multicontact_control.experiment.study.presets.sweep.plan import SweepPlan
import numpy as np
import pyarrow as pa

matplotlib.use('Agg')

COLOURS = ('#1f3b73', '#c26a00', '#18794e', '#c0262d', '#6b4fa0', '#777777', '#0b8a9e', '#8a6d00')
WIDE_RANGE = 20.0  # largest over smallest, from which an axis is logarithmic


def draw_sweep(plan: SweepPlan, table: pa.Table, metrics: Sequence[str]) -> Figure:
    """
    Return the picture of a sweep.

    A column for each plant, a row for each metric. Lines are medians, bands go from the smallest
    to the largest over seeds and whatever else is swept, both of the stable runs; `stable` is
    their share.

    Parameters
    ----------
    plan, table
        Of the sweep.
    metrics
        What to draw, at least one.

    """
    plants = plan.study.plants
    figure = Figure(figsize=(4.6 * len(plants) + 1.0, 2.4 * len(metrics) + 1.0),
                    layout='constrained')
    grid = figure.subplots(len(metrics), len(plants), sharex=True, sharey='row', squeeze=False)
    names = list(plan.units)
    for column, plant in enumerate(plants):
        for row, metric in enumerate(metrics):
            _panel(grid[row, column], plan, table, plant, metric)
            if column == 0:
                grid[row, column].set_ylabel(_label(metric), fontsize=8)
        grid[0, column].set_title(f'plant {plant}', fontsize=9)
        if names:
            unit = plan.units[names[0]]
            grid[-1, column].set_xlabel(f'{names[0]} [{unit}]' if unit else names[0], fontsize=8)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    if len(names) > 1:
        figure.legend(handles, labels, loc='outside lower center', ncols=4, fontsize=8,
                      title=names[1], title_fontsize=8)
    return figure


def _label(metric: str) -> str:
    if metric == STABLE:
        return 'share of stable runs'
    return '\n'.join(metric.replace('*', 'worst').rsplit('.', 1))


def _panel(axes: Axes, plan: SweepPlan, table: pa.Table, plant: str, metric: str) -> None:
    names = list(plan.units)
    values = judged(table, metric)
    here = [run for run in plan.runs if run.plant == plant]
    across: list[Any] = _ordered([run.values[names[0]] for run in here]) if names else ['']
    numeric = all(_is_number(value) for value in across)
    places = across if numeric else list(range(len(across)))
    lines = _ordered([run.values[names[1]] for run in here]) if len(names) > 1 else ['']
    for number, line in enumerate(lines):
        chosen = [[run.number for run in here
                   if (not names or run.values[names[0]] == value)
                   and (len(names) < 2 or run.values[names[1]] == line)] for value in across]
        low, mid, high = _spread(values, chosen, metric)
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(places, mid, 'o-', markersize=3, linewidth=1.2, color=colour, label=str(line))
        axes.fill_between(places, low, high, color=colour, alpha=0.15, linewidth=0)
    if numeric and min(across) > 0.0 and max(across) / min(across) >= WIDE_RANGE:
        axes.set_xscale('log')
    if not numeric:
        axes.set_xticks(places, [str(value) for value in across], fontsize=8)
    if metric == STABLE:
        axes.set_ylim(-0.05, 1.05)
    axes.grid(alpha=0.3)


def _spread(
    values: Vector | None, chosen: Sequence[Sequence[int]], metric: str,
) -> tuple[Vector, Vector, Vector]:
    """Return smallest value, median (of `stable`: mean) and largest value at each place."""
    spread = np.full((3, len(chosen)), np.nan)
    for place, rows in enumerate(chosen):
        known = values[list(rows)] if values is not None else np.empty(0)
        known = known[np.isfinite(known)]
        if known.size and metric == STABLE:
            spread[:, place] = known.mean()
        elif known.size:
            spread[:, place] = known.min(), np.median(known), known.max()
    low, mid, high = spread
    return low, mid, high


def _ordered(values: Sequence[Any]) -> list[Any]:
    """Return each value once, numbers by size."""
    found = list(dict.fromkeys(values))
    return sorted(found) if all(_is_number(value) for value in found) else found


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
