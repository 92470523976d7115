"""The figure of a study: medians of some columns against a factor, with bands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from multicontact_control.experiment.page import COLOURS
from multicontact_control.experiment.study.config import StudyConfig
from multicontact_control.experiment.study.table import (
    judged,
    NOT_FACTORS,
    table_columns,
    worst,
)
import numpy as np
import pandas as pd

WIDE_RANGE = 20.0  # largest over smallest, from which an axis is logarithmic


def draw_study(frame: pd.DataFrame, study: StudyConfig) -> Figure | None:
    """
    Return the figure of a study, a column for each plant, a row for each value.

    Lines are medians, bands go from the smallest to the largest over seeds and whatever else is
    varied; the share of good runs is a line alone. None without a factor or a value to draw.
    """
    config = study.figure
    if config is None:
        return None
    names = [name for name in frame.attrs['factors'] if name not in NOT_FACTORS]
    x, lines = ([config.x, config.lines][i] or (names[i] if len(names) > i else '')
                for i in (0, 1))
    values = [value for value in config.values or (
        column.value for column in table_columns(frame, study)
        if column.aggregate in ('median', 'share'))
        if value == study.truth or worst(frame, value).notna().any()]
    if config.parts:
        frame = frame[frame['part'].isin(config.parts)]
    if not (x and values and len(frame)):
        return None
    plants = list(frame['plant'].unique())
    figure = Figure(figsize=(4.6 * len(plants) + 1.0, 2.4 * len(values) + 1.0),
                    layout='constrained')
    grid = figure.subplots(len(values), len(plants), sharex=True, sharey='row', squeeze=False)
    for column, plant in enumerate(plants):
        here = frame[frame['plant'] == plant]
        for axes, value in zip(grid[:, column], values):
            _panel(axes, here, study, (x, lines, value))
            if column == 0:
                axes.set_ylabel('share of good runs' if value == study.truth else value.replace(
                    '*', 'worst').replace('.', '\n'), fontsize=8)
        grid[0, column].set_title(f'plant {plant}', fontsize=9)
        unit = frame.attrs['units'].get(x)
        grid[-1, column].set_xlabel(f'{x} [{unit}]' if unit else x, fontsize=8)
    if lines:
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc='outside lower center', ncols=4, fontsize=8,
                      title=lines, title_fontsize=8)
    return figure


def _panel(
    axes: Axes, frame: pd.DataFrame, study: StudyConfig, names: tuple[str, str, str],
) -> None:
    x, lines, value = names
    across = _ordered(frame[x].unique())
    numeric = all(map(_is_number, across))
    places = across if numeric else list(range(len(across)))
    share = value == study.truth
    cells = frame if share else judged(frame, study)
    for number, line in enumerate(_ordered(frame[lines].unique()) if lines else ['']):
        chosen = cells[cells[lines] == line] if lines else cells
        series = worst(chosen.astype({study.truth: float}), value)
        groups = series.replace(np.inf, np.nan).groupby(chosen[x])
        low, middle, high = (found.reindex(across) for found in (
            [groups.mean()] * 3 if share else (groups.min(), groups.median(), groups.max())))
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(places, middle, 'o-', markersize=3, linewidth=1.2, color=colour,
                  label=str(line))
        axes.fill_between(places, low, high, color=colour, alpha=0.15, linewidth=0)
    if numeric and min(across) > 0.0 and max(across) / min(across) >= WIDE_RANGE:
        axes.set_xscale('log')
    if not numeric:
        axes.set_xticks(places, [str(each) for each in across], fontsize=8, rotation=30,
                        ha='right')
    if share:
        axes.set_ylim(-0.05, 1.05)
    axes.grid(alpha=0.3)


def _ordered(values: Sequence[Any]) -> list[Any]:
    """Return the values, numbers by size."""
    return sorted(values) if all(map(_is_number, values)) else list(values)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.number)) and not isinstance(value, (bool, np.bool_))
