"""The table of a study: lines that stand for several of its runs, in texts and in a figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
import math
import re
from typing import Any

from matplotlib.figure import Figure
from multicontact_control.experiment.overrides import EVERY
from multicontact_control.experiment.page import COLOURS
from multicontact_control.experiment.study.config import ColumnConfig, StudyConfig
import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

WIDE_RANGE = 20.0  # largest over smallest, from which an axis is logarithmic
MARKERS = 'osD^vPX'  # one for each of COLOURS
Listing = Mapping[str, pd.DataFrame]  # texts of lines and columns, by section
MOST_SHOWN = 5  # columns in sentences and in the figure
NOT_FACTORS = ('part', 'plant', 'seed')
CHOICE = {  # of columns to show
    'rise [s]': 'contacts.*.step_rise_63_s',
    'rest rms [N]': 'contacts.*.rest.true_error_rms_n',
    'move rms [N]': 'contacts.*.moving.true_error_rms_n'}


def columns_of(frame: pd.DataFrame, value: str) -> pd.DataFrame:
    """Return the columns of numbers that a name stands for, with ``*`` for one part of it."""
    pattern = '[^.*]+'.join(map(re.escape, value.split(EVERY)))
    return frame.filter(regex=f'^{pattern}$').select_dtypes(['number', 'bool']).astype(float)


def worst(frame: pd.DataFrame, value: str) -> pd.Series:
    """Return a column, with ``*`` in its name the largest of all; NaN if there is none."""
    return columns_of(frame, value).max(axis=1)


def table_columns(frame: pd.DataFrame, study: StudyConfig) -> list[ColumnConfig]:
    """Return the columns of a study's table, a choice if it has none."""
    columns = study.columns or [ColumnConfig(name=study.truth), *(
        ColumnConfig(name=name, value=value, digits=3) for name, value in CHOICE.items()
        if worst(frame, value).notna().any())]
    return [column if column.value else column.model_copy(update={
        'value': column.name, 'name': column.name.rpartition(f'{EVERY}.')[2],
        'aggregate': 'share' if column.name == study.truth else column.aggregate})
        for column in columns]


def listing_of(frame: pd.DataFrame, study: StudyConfig) -> Listing:
    """Return the tables of a study: a line for each value of its factors, from all seeds."""
    columns = table_columns(frame, study)
    lines = [name for name in study.lines or frame.attrs['factors']
             if name not in (*NOT_FACTORS, *study.sections)
             and frame[name].astype(str).ne('').any()]
    heads = [_head(frame, study, name) for name in lines]
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


def _head(frame: pd.DataFrame, study: StudyConfig, factor: str) -> str:
    """Return what a factor is called in tables and sentences, with its unit in brackets."""
    name = study.symbols.get(factor, factor.rpartition('.')[2].replace('_', ' '))
    unit = frame.attrs['units'].get(factor)
    return f'{name} [{unit}]' if unit else name


def sentences(frame: pd.DataFrame, study: StudyConfig) -> list[str]:
    """Return in how many runs each estimator or law is good, and with which values in all."""
    varied = [name for name in frame.attrs['factors']
              if name not in NOT_FACTORS and frame[name].nunique() > 1]
    subject = [name for name in varied if not pd.api.types.is_numeric_dtype(frame[name])][:1]
    alike: dict[str, list[str]] = {}
    for (plant, *who), runs in _groups(frame, ['plant', *subject]):
        good = runs[study.truth]
        where = '; '.join(
            f'{head} = {values} {unit}'.rstrip() for name in varied if name not in subject
            and runs[name].nunique() > 1
            and (values := good_values(runs, name, study.truth)) != 'none'
            for head, _, unit in [_head(frame, study, name).rstrip(']').partition(' [')])
        count = 'all runs' if good.all() else f'{int(good.sum())} of {len(runs)} runs'
        also = '' if good.all() else 'in every run '
        alike.setdefault(f'{study.truth} on {plant} in {count}' + (
            f', {also}with {where}' if where else ''), []).extend(who or ['The arm'])
    return [f'{", ".join(map(str, names))} {"are" if len(names) > 1 else "is"} {text}.'
            for text, names in alike.items()]


def good_values(frame: pd.DataFrame, factor: str, truth: str) -> str:
    """Return the values of a factor at which all runs are good: a range, a list, or `none`."""
    known = frame[frame[factor].astype(str).ne('')]
    good = known.groupby(factor)[truth].all()
    values, places = [show(value) for value in good.index[good]], np.flatnonzero(good)
    if len(values) > 3 and len(values) == places[-1] - places[0] + 1:
        values = [f'{values[0]} to {values[-1]}']
    return ', '.join(values) or 'none'


def _groups(frame: pd.DataFrame, by: Sequence[str]) -> Iterable[tuple[Any, pd.DataFrame]]:
    """Return the rows of each combination of values, in the order in which they come first."""
    return frame.groupby(list(by) or (lambda _: ''), sort=False, dropna=False)


def show(value: Any) -> str:
    """Return a value as the text of a cell: at least four digits, a dash for no value."""
    if value is None or value != value:
        return '-'
    if isinstance(value, float):
        return f'{value:.4g}' if abs(value) < 1e4 else f'{value:.0f}'
    return str(value)


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
    if column.aggregate == 'good_values':
        chosen = column.value in cells and len(cells)
        return good_values(cells, column.value, study.truth) if chosen else '-'
    if column.aggregate in ('share', 'set'):
        values = cells.get(column.value, pd.Series(dtype=float)).dropna()
        return f'{int(values.sum())}/{len(values)}' if column.aggregate == 'share' else (
            ', '.join(sorted(set(map(str, values)))) or '-')
    numbers = columns_of(cells, column.value)
    if column.each:
        return ' / '.join(_number(numbers[name], column)
                          for name in numbers.dropna(axis=1, how='all')) or '-'
    return _number(numbers.max(axis=1), column)


def terminal_tables(title: str, listing: Listing, width: int) -> list[Table]:
    """
    Return a listing for a terminal of some width [characters].

    What does not fit beside the labels of the lines follows in further tables with the same ones.
    """
    tables = []
    for section, frame in listing.items():
        name = section or title
        for columns in _columns_that_fit(frame, width):
            tables.append(_terminal_table(name, frame, columns))
            name = f'{section or title}, continued'
    return tables


def _columns_that_fit(frame: pd.DataFrame, width: int) -> list[list[str]]:
    """Return the columns beside the labels, as many together as fit into a width."""
    labels = list(frame)[:frame.attrs['labels']]
    room = {name: 2 + max(*map(len, _head_lines(name)), *frame[name].map(len)) for name in frame}
    of_labels = sum(room[name] for name in labels)
    parts: list[list[str]] = []
    used = width
    for name in list(frame)[len(labels):]:
        if used + room[name] >= width:
            parts.append([])
            used = of_labels
        parts[-1].append(name)
        used += room[name]
    return parts or [[]]


def _terminal_table(title: str, frame: pd.DataFrame, columns: Sequence[str]) -> Table:
    """Return the labels of a listing's lines, and some of its columns; long texts are wrapped."""
    labels = list(frame)[:frame.attrs['labels']]
    shown = frame[[*labels, *columns]]
    text = Table(title=escape(title), title_justify='left', box=SIMPLE_HEAD,
                 padding=(0, 1, 0, 0), pad_edge=False)
    for name in shown:
        text.add_column(escape('\n'.join(_head_lines(name))), overflow='fold',
                        justify='left' if name in labels else 'right')
    for line in shown.itertuples(index=False):
        text.add_row(*map(escape, line))
    return text


def _head_lines(name: str) -> list[str]:
    """Return the head of a column, a word on each line."""
    return re.split(r' (?![^[]*\]|/)', name)


def draw_study(frame: pd.DataFrame, study: StudyConfig) -> Figure | None:
    """
    Return the figure of a study, a column for each plant, a row for each value that varies.

    Points are medians of the good runs over the first factor, or the share of good runs, for each
    part and value of the second factor. None without a factor or a value to draw.
    """
    names = [name for name in frame.attrs['factors'] if name not in NOT_FACTORS]
    columns = [column for column in table_columns(frame, study)
               if column.aggregate in ('median', 'share')
               and worst(frame, column.value).nunique() > 1][:MOST_SHOWN]
    if not (study.figure and names and columns):
        return None
    lines = ['part'] if frame['part'].nunique() > 1 else []
    lines += names[1:2] or ['part'] * (not lines)
    plants = list(frame['plant'].unique())
    figure = Figure(figsize=(4.6 * len(plants) + 2.5, 2.2 * len(columns) + 1.0),
                    layout='constrained')
    grid = figure.subplots(len(columns), len(plants), sharex='col', sharey='row', squeeze=False)
    for axes, (column, plant) in zip(grid.flat, product(columns, plants)):
        _draw(axes, frame[frame['plant'] == plant], names[0], lines, column, study.truth)
        name = column.name.replace('*', 'worst').replace('.', '\n')
        axes.set_ylabel(f'share of {name} runs' if column.aggregate == 'share' else name,
                        fontsize=8)
        axes.set_xlabel(_head(frame, study, names[0]), fontsize=8)
        axes.label_outer()
    for axes, plant in zip(grid[0], plants):
        axes.set_title(f'plant {plant}', fontsize=9)
    handles = {label: line for axes in grid.flat for line, label in zip(
        *axes.get_legend_handles_labels())}
    if len(handles) > 1:
        figure.legend(handles.values(), handles, loc='outside right upper', fontsize=8,
                      title=', '.join(_head(frame, study, name) for name in lines))
    return figure


def _draw(
    axes: Any, frame: pd.DataFrame, x: str, lines: list[str], column: ColumnConfig, truth: str,
) -> None:
    """Draw a column over a factor: lines over numbers, points alone over names."""
    drawn, statistic = worst(frame, column.value), 'mean'
    if column.aggregate == 'median':
        drawn = column.scale * drawn.where(frame[truth] & np.isfinite(drawn))
        statistic = 'median'
    table = frame.assign(drawn=drawn).pivot_table(
        index=x, columns=lines, values='drawn', sort=False, aggfunc=statistic,
    ).reindex(frame[x].unique())
    if table.empty:
        return
    table.columns = [', '.join(map(show, label if isinstance(label, tuple) else (label,)))
                     for label in table]
    numeric = pd.api.types.is_numeric_dtype(table.index)
    table = table.sort_index() if numeric else table
    wide = numeric and table.index[0] > 0.0 and table.index[-1] / table.index[0] >= WIDE_RANGE
    table.plot(ax=axes, style=[f'{mark}{"-" * numeric}' for mark in MARKERS], color=COLOURS,
               markersize=5, alpha=0.8, logx=bool(wide), fontsize=8, legend=False)
    if wide:
        axes.xaxis.set_major_formatter('{x:g}')
    elif not numeric:
        axes.set_xticks(range(len(table)), table.index, rotation=30, ha='right')
    axes.grid(alpha=0.3)
