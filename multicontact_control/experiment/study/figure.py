"""The figure of a study: medians of some columns against a factor."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
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

    Lines are medians over seeds and whatever else is varied, of the column that tells whether a
    run is good the share. None without a factor or a value to draw.
    """
    config = study.figure
    names = [name for name in frame.attrs['factors'] if name not in NOT_FACTORS]
    if config is None or not names:
        return None
    x, lines = config.x or names[0], config.lines or (names[1] if len(names) > 1 else 'part')
    values = [value for value in config.values or (
        column.value for column in table_columns(frame, study)
        if column.aggregate in ('median', 'share'))
        if value == study.truth or worst(frame, value).notna().any()]
    chosen = frame[frame['part'].isin(config.parts or frame['part'].unique())]
    plants = list(frame['plant'].unique())
    figure = Figure(figsize=(4.6 * len(plants) + 1.0, 2.6 * len(values) + 1.0),
                    layout='constrained')
    grid = figure.subplots(len(values), len(plants), sharex=True, sharey='row', squeeze=False)
    for column, plant in enumerate(plants):
        for axes, value in zip(grid[:, column], values):
            share = value == study.truth
            here = chosen[chosen['plant'] == plant]
            _draw(axes, here if share else judged(here, study), (x, lines, value), share)
            axes.set_ylabel('share of good runs' if share else value.replace(
                '*', 'worst').replace('.', '\n'), fontsize=8)
        grid[0, column].set_title(f'plant {plant}', fontsize=9)
    return figure


def _draw(axes: Any, frame: pd.DataFrame, names: tuple[str, str, str], share: bool) -> None:
    x, lines, value = names
    series = frame[value].astype(float) if share else worst(frame, value)
    table = frame.assign(drawn=series.replace(np.inf, np.nan)).pivot_table(
        index=x, columns=lines, values='drawn', aggfunc='mean' if share else 'median', sort=False)
    if table.empty:
        return
    if pd.api.types.is_numeric_dtype(table.index):
        table = table.sort_index()
        logarithmic = table.index[0] > 0.0 and table.index[-1] / table.index[0] >= WIDE_RANGE
        table.plot(ax=axes, style='o-', markersize=3, logx=bool(logarithmic), fontsize=8)
    else:
        table.plot(ax=axes, style='o-', markersize=3, fontsize=8, rot=30)
        axes.set_xticks(range(len(table)), table.index, ha='right')
    axes.legend(fontsize=7, title=lines, title_fontsize=7)
    axes.grid(alpha=0.3)
