"""The table of a study: lines that stand for several of its runs, in texts and in a figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
import math
import re
from textwrap import fill
from typing import Any, NamedTuple

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from multicontact_control.judging.panels import choose_colour
from multicontact_control.runs.overrides import EVERY
from multicontact_control.study.config import ColumnConfig, StudyConfig
import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

WIDE_RANGE = 20.0  # largest over smallest, from which an axis is logarithmic
MARKERS = 'osD^vPp'  # as many as there are colours of curves
CROSS: dict[str, Any] = {
    'linestyle': '',
    'marker': 'x',
    'markersize': 7,
    'clip_on': False,
    'markeredgewidth': 2.0,
    'zorder': 3,
}
SPREAD = 0.8  # of the room of a name, over which its series lie beside each other
ROOM_OF_SERIES = 0.09  # inches
NAME_WIDTH = 24  # characters of a line
LEGEND_COLUMNS = 4
Listing = Mapping[str, pd.DataFrame]  # texts of lines and columns, by section
MOST_SHOWN = 5  # columns in the figure
NOT_FACTORS = ('part', 'plant', 'seed')
USUAL_COLUMNS = {  # those of a study that names none, by their heads
    'rise [s]': 'contacts.*.step_rise_63_s',
    'rest rms [N]': 'contacts.*.rest.true_error_rms_n',
    'move rms [N]': 'contacts.*.moving.true_error_rms_n',
}
NO_VALUE = '-'
NO_GOOD_VALUE = 'none'


def numeric_columns(frame: pd.DataFrame, value: str) -> pd.DataFrame:
    """
    Return the columns of numbers that a name stands for, with ``*`` for one part of it.

    ``contacts.*.rest.rms`` stands for every contact. Truths count as 1 and 0; columns of text are
    left out, so the result may be empty.
    """
    pattern = '[^.*]+'.join(map(re.escape, value.split(EVERY)))
    columns = frame.filter(regex=f'^{pattern}$')
    return columns.select_dtypes(['number', 'bool']).astype(float)


def largest_of_columns(frame: pd.DataFrame, value: str) -> pd.Series:
    """
    Return a column, with ``*`` in its name the largest of all; NaN if there is none.

    The worst contact stands for a run, since errors and times are bad when large; shape (runs,).
    """
    return numeric_columns(frame, value).max(axis=1)


def resolve_columns(frame: pd.DataFrame, study: StudyConfig) -> list[ColumnConfig]:
    """
    Return the columns of a study's table, each with the value that it shows.

    A study that names none has its truth and those of the `USUAL_COLUMNS` that are in the frame.
    The truth is shown as a share of the runs where nothing else is said.
    """
    columns = list(study.columns)
    if not columns:
        columns.append(ColumnConfig(name=study.truth))
        for name, value in USUAL_COLUMNS.items():
            if largest_of_columns(frame, value).notna().any():
                columns.append(ColumnConfig(name=name, value=value, digits=3))
    resolved = []
    for column in columns:
        changes = {}
        if not column.value:
            _, _, name = column.name.rpartition(f'{EVERY}.')
            changes = {'value': column.name, 'name': name}
            if column.name == study.truth:
                changes['aggregate'] = 'share'
        resolved.append(column.model_copy(update=changes))
    return resolved


def make_listing(frame: pd.DataFrame, study: StudyConfig) -> Listing:
    """
    Return the tables of a study, by section: a line for each value of its factors, of all seeds.

    Cells are texts; `attrs['labels']` of a table tells how many columns at the left name the
    line.
    """
    columns = resolve_columns(frame, study)
    elsewhere = {*NOT_FACTORS, *study.sections}
    factors = []
    for name in study.lines or frame.attrs['factors']:
        has_values = frame[name].astype(str).ne('').any()
        if has_values and name not in elsewhere:
            factors.append(name)
    heads = [_describe_factor(frame, study, name) for name in factors]
    by_section = [name for name in study.sections if frame[name].nunique() > 1]
    listing = {}
    for title, section in _group_rows(frame, by_section):
        lines = []
        for values, runs in _group_rows(section, factors):
            line = dict(zip(heads, map(format_value, values)))
            for column in columns:
                line[column.name] = _describe_cell(column, runs, study)
            lines.append(line)
        shown = pd.DataFrame(lines)
        shown.attrs = {'labels': len(factors)}
        words = filter(None, map(str, title))
        listing[', '.join(words)] = shown
    return listing


def _find_name_and_unit(
    frame: pd.DataFrame, study: StudyConfig, factor: str
) -> tuple[str, str]:
    """Return what a factor is called in tables and sentences, and its unit, '' without one."""
    _, _, last_part = factor.rpartition('.')
    name = study.symbols.get(factor, last_part.replace('_', ' '))
    return name, frame.attrs['units'].get(factor, '')


def _describe_factor(frame: pd.DataFrame, study: StudyConfig, factor: str) -> str:
    """Return what a factor is called in tables and figures, with its unit in brackets."""
    name, unit = _find_name_and_unit(frame, study, factor)
    if unit:
        return f'{name} [{unit}]'
    return name


def _write_equation(
    frame: pd.DataFrame, study: StudyConfig, factor: str, text: str
) -> str:
    """Return a factor and its values as they stand in a sentence: name = values unit."""
    name, unit = _find_name_and_unit(frame, study, factor)
    return f'{name} = {text} {unit}'.rstrip()


def describe_good_runs(frame: pd.DataFrame, study: StudyConfig) -> list[str]:
    """
    Return in how many runs each estimator or law is good, and with which values in all.

    A run is good if `study.truth` holds. The first varied factor of names is the subject of the
    sentences; subjects of which the same can be said share one. There are sentences for each
    plant.
    """
    subject: list[str] = []
    conditions = []
    for name in frame.attrs['factors']:
        if name in NOT_FACTORS or frame[name].nunique() < 2:
            continue
        if subject or is_numeric_dtype(frame[name]):
            conditions.append(name)
        else:
            subject.append(name)
    subjects_by_statement: dict[str, list[str]] = {}
    for (plant, *subjects), runs in _group_rows(frame, ['plant', *subject]):
        good = runs[study.truth]
        equations = []
        for name in conditions:
            values = list_good_values(runs, name, study.truth)
            if runs[name].nunique() > 1 and values != NO_GOOD_VALUE:
                equations.append(_write_equation(frame, study, name, values))
        count = 'all runs'
        condition = 'with'
        if not good.all():
            count = f'{int(good.sum())} of {len(runs)} runs'
            condition = 'in every run with'
        statement = f'{study.truth} on {plant} in {count}'
        if equations:
            statement += f', {condition} {"; ".join(equations)}'
        same = subjects_by_statement.setdefault(statement, [])
        same += map(str, subjects or ['The arm'])
    sentences = []
    for statement, subjects in subjects_by_statement.items():
        verb = 'is'
        if len(subjects) > 1:
            verb = 'are'
        sentences.append(f'{", ".join(subjects)} {verb} {statement}.')
    return sentences


def list_good_values(frame: pd.DataFrame, factor: str, truth: str) -> str:
    """
    Return the values of a factor at which all runs are good, as a text.

    They are a list, from four neighbours on a range, or `none`.
    """
    known = frame[frame[factor].astype(str).ne('')]
    is_good = known.groupby(factor)[truth].all()
    values = list(map(format_value, is_good.index[is_good]))
    if not values:
        return NO_GOOD_VALUE
    places = np.flatnonzero(is_good)
    are_neighbours = len(values) == places[-1] - places[0] + 1
    if len(values) > 3 and are_neighbours:
        return f'{values[0]} to {values[-1]}'
    return ', '.join(values)


def _group_rows(
    frame: pd.DataFrame, factors: Sequence[str]
) -> Iterable[tuple[tuple[Any, ...], pd.DataFrame]]:
    """Return the rows of each combination of values, in the order in which they come first."""
    if not factors:
        return [((), frame)]
    return frame.groupby(list(factors), sort=False, dropna=False)


def format_value(value: Any) -> str:
    """
    Return a value as the text of a cell: at least four digits, a dash for no value.

    None and NaN are no values. Large numbers are written out and not with an exponent, so that a
    column can be compared at a glance.
    """
    if value is None or value != value:
        return NO_VALUE
    if not isinstance(value, float):
        return str(value)
    if abs(value) < 1e4:
        return f'{value:.4g}'
    return f'{value:.0f}'


def _format_statistic(values: pd.Series, column: ColumnConfig) -> str:
    """Return a statistic of the values that are known; infinite stands for a time of no event."""
    known = values.dropna()
    if known.empty:
        return NO_VALUE
    value = float(known.agg(column.aggregate))
    if math.isinf(value):
        return 'never'
    value *= column.scale
    if column.digits is None:
        return format_value(value)
    return f'{value:.{column.digits}f}'


def _describe_cell(column: ColumnConfig, runs: pd.DataFrame, study: StudyConfig) -> str:
    """Return the text of a column in the line that stands for some runs."""
    if column.part:
        runs = runs[runs['part'] == column.part]
    if column.aggregate == 'good_values':
        if runs.empty or column.value not in runs:
            return NO_VALUE
        return list_good_values(runs, column.value, study.truth)
    if column.aggregate in ('share', 'set'):
        values = runs.get(column.value, pd.Series(dtype=float)).dropna()
        if column.aggregate == 'share':
            return f'{int(values.sum())}/{len(values)}'
        return ', '.join(sorted(set(map(str, values)))) or NO_VALUE
    numbers = numeric_columns(runs, column.value)
    if not column.each:
        return _format_statistic(numbers.max(axis=1), column)
    known = numbers.dropna(axis=1, how='all')
    texts = [_format_statistic(known[name], column) for name in known]
    return ' / '.join(texts) or NO_VALUE


def terminal_tables(title: str, listing: Listing, width: int) -> list[Table]:
    """
    Return a listing for a terminal of some width [characters].

    What does not fit beside the labels of the lines follows in further tables with the same ones.
    """
    tables = []
    for section, frame in listing.items():
        name = section or title
        heading = name
        for columns in _columns_that_fit(frame, width):
            tables.append(_terminal_table(heading, frame, columns))
            heading = f'{name}, continued'
    return tables


def _columns_that_fit(frame: pd.DataFrame, width: int) -> list[list[str]]:
    """Return the columns beside the labels, as many together as fit into a width."""
    names = list(frame)
    rooms = []
    for name in names:
        longest_word = max(map(len, _split_head(name)))
        rooms.append(2 + max(longest_word, frame[name].str.len().max()))
    labels = frame.attrs['labels']
    room_of_labels = sum(rooms[:labels])
    parts: list[list[str]] = []
    used = width
    for name, room in zip(names[labels:], rooms[labels:]):
        if used + room >= width:
            parts.append([])
            used = room_of_labels
        parts[-1].append(name)
        used += room
    return parts or [[]]


def _terminal_table(title: str, frame: pd.DataFrame, columns: Sequence[str]) -> Table:
    """Return the labels of a listing's lines, and some of its columns; long texts are wrapped."""
    labels = list(frame)[: frame.attrs['labels']]
    shown = frame[[*labels, *columns]]
    text = Table(
        title=escape(title),
        title_justify='left',
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    for name in shown:
        head = '\n'.join(_split_head(name))
        text.add_column(escape(head), overflow='fold', justify='right')
    for column in text.columns[: len(labels)]:
        column.justify = 'left'
    for line in shown.itertuples(index=False):
        text.add_row(*map(escape, line))
    return text


def _split_head(name: str) -> list[str]:
    """Return the head of a column, a word on each line."""
    return re.split(r' (?![^[]*\]|/)', name)


class Series(NamedTuple):
    """
    Runs that are one series of points in every panel of a figure.

    Its label is what the legend says: values of the factors that tell it from the others. Colour
    and marker differ together, to be told apart in grey.
    """

    label: str
    runs: pd.DataFrame
    style: Mapping[str, Any]  # of its points

    def on_plant(self, plant: str) -> Series:
        """
        Return the series with its runs on a plant alone.

        A figure has a panel for each plant, and label and colour stay the same in all, so that one
        legend serves them.
        """
        return self._replace(runs=self.runs[self.runs['plant'] == plant])


def draw_study(frame: pd.DataFrame, study: StudyConfig) -> Figure | None:
    """
    Return the figure of a study, a panel for each plant and each value that varies.

    Points are medians of the good runs over the first factor, or the share of good runs, for each
    part and value of the second factor; a cross stands where no run is good. Names of a first
    factor are lines, its numbers an axis. None without a factor or a value to draw.
    """
    names = [name for name in frame.attrs['factors'] if name not in NOT_FACTORS]
    columns = []
    for column in resolve_columns(frame, study):
        varies = largest_of_columns(frame, column.value).nunique() > 1
        if varies and column.aggregate in ('median', 'share'):
            columns.append(column)
    columns = columns[:MOST_SHOWN]
    if not (study.figure and names and columns):
        return None
    factor = names[0]
    lines = names[1:2]
    if frame['part'].nunique() > 1 or not lines:
        lines = ['part', *lines]
    series = group_series(frame, study, lines)
    if is_numeric_dtype(frame[factor]):
        figure = _draw_numbers(frame, study, factor, columns, series)
    else:
        figure = _draw_names(frame, study, factor, columns, series)
    shown: dict[str, Any] = {}
    for axes in figure.axes:
        for line, label in zip(*axes.get_legend_handles_labels()):
            shown.setdefault(label, line)
    has_good_run = frame.groupby([factor, 'plant', *lines])[study.truth].any()
    if not has_good_run.all():
        shown[f'no {study.truth} run'] = Line2D([], [], color='#222222', **CROSS)
    if len(shown) > 1:
        figure.legend(
            shown.values(),
            shown,
            loc='outside lower center',
            fontsize=9,
            ncols=min(len(shown), LEGEND_COLUMNS),
            frameon=False,
        )
    return figure


def group_series(
    frame: pd.DataFrame, study: StudyConfig, factors: Sequence[str]
) -> list[Series]:
    """
    Return the runs by values of some factors, each group with its name and look.

    The order is that in which the groups first come in the table. After seven series colours and
    markers come again. Without factors there is one series of all runs.
    """
    series = []
    for number, (values, runs) in enumerate(_group_rows(frame, factors)):
        words = []
        for factor, value in zip(factors, values):
            word = format_value(value)
            if factor != 'part':
                word = _write_equation(frame, study, factor, word)
            words.append(word)
        style = {
            'color': choose_colour(number),
            'marker': MARKERS[number % len(MARKERS)],
            'markersize': 5,
        }
        series.append(Series(', '.join(words), runs, style))
    return series


def _draw_numbers(
    frame: pd.DataFrame,
    study: StudyConfig,
    factor: str,
    columns: Sequence[ColumnConfig],
    series: Sequence[Series],
) -> Figure:
    """Draw curves over a factor: a column of panels for each plant, a row for each value."""
    plants = list(frame['plant'].unique())
    figure = Figure(
        figsize=(4.6 * len(plants) + 1.0, 2.2 * len(columns) + 1.5),
        layout='constrained',
    )
    grid = figure.subplots(
        len(columns), len(plants), sharex='col', sharey='row', squeeze=False
    )
    for axes, (column, plant) in zip(grid.flat, product(columns, plants)):
        for each in series:
            values, without_good_run = _find_points(
                each.on_plant(plant).runs, factor, column, study
            )
            values = values.sort_index()
            axes.plot(
                values.index, values, '-', alpha=0.8, label=each.label, **each.style
            )
            for value in without_good_run:
                axes.plot(
                    value,
                    0.0,
                    transform=axes.get_xaxis_transform(),
                    color=each.style['color'],
                    **CROSS,
                )
        known = np.sort(frame.loc[frame['plant'] == plant, factor].unique())
        if known[0] > 0.0 and known[-1] / known[0] >= WIDE_RANGE:
            axes.set_xscale('log')
            axes.xaxis.set_major_formatter('{x:g}')
        axes.set_ylabel(_describe_axis(column), fontsize=8)
        axes.set_xlabel(_describe_factor(frame, study, factor), fontsize=8)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.3)
        axes.label_outer()
    for axes, plant in zip(grid[0], plants):
        axes.set_title(f'plant {plant}', fontsize=9)
    return figure


def _draw_names(
    frame: pd.DataFrame,
    study: StudyConfig,
    factor: str,
    columns: Sequence[ColumnConfig],
    series: Sequence[Series],
) -> Figure:
    """Draw points beside the names of a factor: a row of panels for each plant."""
    names = frame.groupby('plant', sort=False)[factor].unique()  # by plant
    room = 0.25 + ROOM_OF_SERIES * len(series)  # inches, of a name
    heights = room * names.map(len) + 0.3
    width = 2.4 * len(columns) + 2.0
    figure = Figure(figsize=(width, heights.sum() + 1.3), layout='constrained')
    grid = figure.subplots(
        len(names),
        len(columns),
        sharex='col',
        sharey='row',
        squeeze=False,
        height_ratios=heights,
    )
    for axes, ((plant, known), column) in zip(
        grid.flat, product(names.items(), columns)
    ):
        on_plant = [each.on_plant(plant) for each in series]
        places = _find_places_of_names(on_plant, factor, known)
        for each in on_plant:
            values, without_good_run = _find_points(each.runs, factor, column, study)
            levels = [places[name, each.label] for name in values.index]
            axes.plot(values, levels, linestyle='', label=each.label, **each.style)
            for name in without_good_run:
                axes.plot(
                    0.0,
                    places[name, each.label],
                    transform=axes.get_yaxis_transform(),
                    color=each.style['color'],
                    **CROSS,
                )
        for place in range(0, len(known), 2):
            axes.axhspan(place - 0.5, place + 0.5, color='#f4f5f7', zorder=0)
        labels = [fill(str(name), NAME_WIDTH) for name in known]
        axes.set_yticks(range(len(known)), labels)
        axes.set_ylim(len(known) - 0.5, -0.5)
        axes.set_xlabel(_describe_axis(column), fontsize=9)
        axes.tick_params(labelsize=9)
        axes.grid(axis='x', alpha=0.4)
        axes.label_outer()
    for axes, plant in zip(grid[:, 0], names.index):
        axes.set_title(f'plant {plant}', fontsize=10, loc='left')
    return figure


def _find_places_of_names(
    series: Sequence[Series],
    factor: str,
    names: Sequence[Any],
) -> dict[tuple[Any, str], float]:
    """Return where each series of each name lies: beside each other, around the name's place."""
    places = {}
    for place, name in enumerate(names):
        labels = [each.label for each in series if (each.runs[factor] == name).any()]
        for number, label in enumerate(labels):
            share = (number + 0.5) / len(labels) - 0.5
            places[name, label] = place + SPREAD * share
    return places


def _describe_axis(column: ColumnConfig) -> str:
    """Return what an axis with the values of a column is called, in several lines."""
    name = column.name.replace('*', 'worst').replace('.', '\n')
    if column.aggregate == 'share':
        return f'share of {name} runs'
    return name


def _find_points(
    runs: pd.DataFrame,
    factor: str,
    column: ColumnConfig,
    study: StudyConfig,
) -> tuple[pd.Series, list[Any]]:
    """
    Return what is drawn of runs by the value of a factor, and where a cross takes its place.

    A share counts all runs, a median the good ones alone: without any there is nothing to draw.
    """
    numbers = largest_of_columns(runs, column.value)
    if column.aggregate == 'share':
        drawn = runs.assign(drawn=numbers).groupby(factor, sort=False)['drawn']
        return drawn.mean(), []
    known = column.scale * numbers.where(runs[study.truth] & np.isfinite(numbers))
    by_value = runs.assign(drawn=known).groupby(factor, sort=False)
    good = by_value[study.truth].any()
    return by_value['drawn'].median(), list(good.index[~good])
