"""The table of a study: lines that stand for several of its runs, in texts and in a figure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from itertools import product
import math
import re
from typing import Any

from matplotlib.figure import Figure
from multicontact_control.experiment.overrides import EVERY
from multicontact_control.experiment.page import table
from multicontact_control.experiment.study.config import ColumnConfig, StudyConfig
import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.markup import escape as plain
from rich.table import Table

WIDE_RANGE = 20.0  # largest over smallest, from which an axis is logarithmic
WIDE = 130  # columns of a terminal that has room for every column of a table
LABEL = 18  # characters of a label that stay in one line
Listing = Mapping[str, pd.DataFrame]  # texts of lines and columns, by section
NOT_FACTORS = ('part', 'plant', 'seed')
CHOICE = (  # of columns to show
    'contacts.*.step_rise_63_s', 'contacts.*.rest.true_error_rms_n',
    'contacts.*.moving.true_error_rms_n')


def columns_of(frame: pd.DataFrame, value: str) -> pd.DataFrame:
    """Return the columns of numbers that a name stands for, with ``*`` for one part of it."""
    pattern = '[^.*]+'.join(map(re.escape, value.split(EVERY)))
    return frame.filter(regex=f'^{pattern}$').select_dtypes(['number', 'bool']).astype(float)


def worst(frame: pd.DataFrame, value: str) -> pd.Series:
    """Return a column, with ``*`` in its name the largest of all; NaN if there is none."""
    return columns_of(frame, value).max(axis=1)


def judged(frame: pd.DataFrame, study: StudyConfig) -> pd.DataFrame:
    """Return the cells that the statistics of a study are of."""
    return frame if study.medians == 'all' else frame[frame[study.truth]]


def table_columns(frame: pd.DataFrame, study: StudyConfig) -> list[ColumnConfig]:
    """Return the columns of a study's table, a choice if it has none."""
    columns = study.columns or [ColumnConfig(name=name) for name in (study.truth, *(
        name for name in CHOICE if worst(frame, name).notna().any()))]
    return [column if column.value else column.model_copy(update={
        'value': column.name, 'name': column.name.rpartition(f'{EVERY}.')[2],
        'aggregate': 'share' if column.name == study.truth else column.aggregate})
        for column in columns]


def listing_of(frame: pd.DataFrame, study: StudyConfig) -> Listing:
    """Return the tables of a study: a line for each value of its factors, from all seeds."""
    columns, units = table_columns(frame, study), frame.attrs['units']
    lines = [name for name in study.lines or frame.attrs['factors']
             if name not in (*NOT_FACTORS, *study.sections)
             and frame[name].astype(str).ne('').any()]
    heads = [name.rpartition('.')[2].replace('_', ' ') + (
        f' [{units[name]}]' if units.get(name) else '') for name in lines]
    by = [name for name in study.sections if frame[name].nunique() > 1]
    listing = {}
    for title, section in _groups(frame, by):
        shown = pd.DataFrame([
            {**dict(zip(heads, map(show, label))),
             **{column.name: _cell(column, group, study) for column in columns}}
            for label, group in _groups(section, lines)])
        shown.attrs = {'labels': len(lines)}  # columns at the left that are no numbers
        listing[', '.join(filter(None, map(str, title)))] = shown
    return listing


def _groups(frame: pd.DataFrame, by: Sequence[str]) -> Iterable[tuple[Any, pd.DataFrame]]:
    """Return the rows of each combination of values, in the order in which they come first."""
    return frame.groupby(list(by) or (lambda _: ''), sort=False, dropna=False)


def show(value: Any) -> str:
    """Return a value as the text of a cell: four significant digits, a dash for no value."""
    if value is None or value != value:
        return '-'
    if isinstance(value, (bool, np.bool_)):
        return 'yes' if value else 'no'
    return f'{value:.4g}' if isinstance(value, float) else str(value)


def _number(values: pd.Series, column: ColumnConfig) -> str:
    """Return a statistic of the values that are known; infinite stands for a time of no event."""
    known = values.dropna()
    if known.empty:
        return '-'
    value = float(known.agg(column.aggregate))
    if math.isinf(value):
        return 'never'
    value *= column.scale
    return show(value) if column.digits is None else f'{value:.{column.digits}f}'


def _cell(column: ColumnConfig, group: pd.DataFrame, study: StudyConfig) -> str:
    cells = group if not column.part else group[group['part'] == column.part]
    if column.aggregate in FUNCTIONS:
        return FUNCTIONS[column.aggregate](cells, column.value, study.truth) if (
            column.value in cells) else '-'  # a part that was not chosen
    if column.aggregate in ('share', 'set'):
        values = cells.get(column.value, pd.Series(dtype=float)).dropna()
        return f'{int(values.sum())}/{len(values)}' if column.aggregate == 'share' else (
            ', '.join(sorted(set(map(str, values)))) or '-')
    numbers = columns_of(judged(cells, study), column.value)
    if column.each:
        return ' / '.join(_number(numbers[name], column)
                          for name in numbers.dropna(axis=1, how='all')) or '-'
    return _number(numbers.max(axis=1), column)


def survived(frame: pd.DataFrame, factor: str, truth: str) -> str:
    """Return the values of a factor at which all are good; in brackets where none oscillates."""
    texts = []
    for value, group in frame.groupby(factor):
        if group[truth].all():
            texts.append(f'{value:g}')
        elif not group['oscillates'].any():
            texts.append(f'({value:g})')
    return ' '.join(texts) or ('none' if len(frame) else '-')


def stable_range(frame: pd.DataFrame, factor: str, truth: str) -> str:
    """Return the smallest and largest value around 1 from which to which all are good."""
    good = frame.groupby(factor)[truth].all()
    middle = int(np.argmin(np.abs(np.log(good.index.to_numpy(float)))))
    if not good.iloc[middle]:
        return 'none'
    bad = np.flatnonzero(~good.to_numpy(bool))
    low = max((place + 1 for place in bad if place < middle), default=0)
    high = min((place - 1 for place in bad if place > middle), default=len(good) - 1)
    return f'{good.index[low]:g} - {good.index[high]:g}'


FUNCTIONS: Mapping[str, Callable[[pd.DataFrame, str, str], str]] = {
    'survived': survived, 'stable_range': stable_range}


def terminal_tables(title: str, listing: Listing, study: StudyConfig, width: int) -> list[Table]:
    """Return a listing for a terminal of some width; a narrow one lacks some columns."""
    left_out = {column.name for column in study.columns if column.wide and width < WIDE}
    tables = []
    for section, frame in listing.items():
        labels = list(frame)[:frame.attrs['labels']]
        shown = frame[[name for name in frame if name not in left_out]]
        text = Table(title=plain(section or title), title_justify='left', box=SIMPLE_HEAD,
                     padding=(0, 1, 0, 0), pad_edge=False)
        for name in shown:
            short = name in labels and frame[name].str.len().max() <= LABEL
            text.add_column(
                plain(name.replace(' ', '\n') if short else name), overflow='fold',
                justify='left' if name in labels else 'right', no_wrap=short)
        for line in shown.itertuples(index=False):
            text.add_row(*map(plain, line))
        tables.append(text)
    return tables


def html_tables(listing: Listing) -> str:
    """Return a listing as HTML."""
    return ''.join(
        f'<h2>{escape(section)}</h2>' + table(
            list(map(escape, frame)), [list(map(escape, line)) for line in frame.to_numpy()],
            numbers_from=frame.attrs['labels'])
        for section, frame in listing.items())


def draw_study(frame: pd.DataFrame, study: StudyConfig) -> Figure | None:
    """
    Return the figure of a study, a column for each plant, a row for each value.

    The first factor is along the horizontal axis; there is a line for each part and value of the
    second: medians over seeds and whatever else is varied, or the share of good runs. Values that
    do not vary are left out. None without a factor or a value to draw.
    """
    names = [name for name in frame.attrs['factors'] if name not in NOT_FACTORS]
    columns = [column for column in table_columns(frame, study)
               if column.aggregate in ('median', 'share')
               and worst(frame, column.value).nunique() > 1]
    if not (study.figure and names and columns):
        return None
    lines = ['part'] if frame['part'].nunique() > 1 else []
    lines += names[1:2] or ['part'] * (not lines)
    plants = list(frame['plant'].unique())
    figure = Figure(figsize=(4.6 * len(plants) + 1.0, 2.6 * len(columns) + 1.0),
                    layout='constrained')
    grid = figure.subplots(len(columns), len(plants), sharex=True, sharey='row', squeeze=False)
    for axes, (column, plant) in zip(grid.flat, product(columns, plants)):
        here, share = frame[frame['plant'] == plant], column.aggregate == 'share'
        _draw(axes, here if share else judged(here, study), names[0], lines, column)
        axes.set_ylabel(f'share of {column.value} runs' if share else column.name.replace(
            '*', 'worst').replace('.', '\n'), fontsize=8)
    for axes, plant in zip(grid[0], plants):
        axes.set_title(f'plant {plant}', fontsize=9)
        if len(axes.lines) > 1:
            axes.legend(fontsize=7, title=', '.join(lines), title_fontsize=7)
    return figure


def _draw(
    axes: Any, frame: pd.DataFrame, x: str, lines: list[str], column: ColumnConfig,
) -> None:
    drawn = worst(frame, column.value).replace(np.inf, np.nan)
    table = frame.assign(drawn=drawn).pivot_table(
        index=x, columns=lines, values='drawn', sort=False,
        aggfunc='mean' if column.aggregate == 'share' else 'median')
    if table.empty:
        return
    if pd.api.types.is_numeric_dtype(table.index):
        table = table.sort_index()
        logarithmic = table.index[0] > 0.0 and table.index[-1] / table.index[0] >= WIDE_RANGE
        table.plot(ax=axes, style='o-', markersize=3, logx=bool(logarithmic), fontsize=8,
                   legend=False)
    else:
        table.plot(ax=axes, style='o-', markersize=3, fontsize=8, rot=30, legend=False)
        axes.set_xticks(range(len(table)), table.index, ha='right')
    axes.grid(alpha=0.3)
