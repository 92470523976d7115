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
from multicontact_control.judging.panels import CURVE_COLOURS
from multicontact_control.runs.overrides import EVERY
from multicontact_control.study.config import ColumnConfig, StudyConfig
import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

WIDE_RANGE = 20.0  # largest over smallest, from which an axis is logarithmic
MARKERS = 'osD^vPp'  # one for each of COLOURS
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
MOST_SHOWN = 5  # columns in sentences and in the figure
NOT_FACTORS = ('part', 'plant', 'seed')
CHOICE = {  # of columns to show
    'rise [s]': 'contacts.*.step_rise_63_s',
    'rest rms [N]': 'contacts.*.rest.true_error_rms_n',
    'move rms [N]': 'contacts.*.moving.true_error_rms_n',
}


def columns_of(frame: pd.DataFrame, value: str) -> pd.DataFrame:
    """Return the columns of numbers that a name stands for, with ``*`` for one part of it."""
    pattern = '[^.*]+'.join(map(re.escape, value.split(EVERY)))
    return (
        frame.filter(regex=f'^{pattern}$')
        .select_dtypes(['number', 'bool'])
        .astype(float)
    )


def worst(frame: pd.DataFrame, value: str) -> pd.Series:
    """Return a column, with ``*`` in its name the largest of all; NaN if there is none."""
    return columns_of(frame, value).max(axis=1)


def table_columns(frame: pd.DataFrame, study: StudyConfig) -> list[ColumnConfig]:
    """Return the columns of a study's table, a choice if it has none."""
    columns = study.columns or [
        ColumnConfig(name=study.truth),
        *(
            ColumnConfig(name=name, value=value, digits=3)
            for name, value in CHOICE.items()
            if worst(frame, value).notna().any()
        ),
    ]
    return [
        column
        if column.value
        else column.model_copy(
            update={
                'value': column.name,
                'name': column.name.rpartition(f'{EVERY}.')[2],
                'aggregate': 'share'
                if column.name == study.truth
                else column.aggregate,
            }
        )
        for column in columns
    ]


def listing_of(frame: pd.DataFrame, study: StudyConfig) -> Listing:
    """Return the tables of a study: a line for each value of its factors, from all seeds."""
    columns = table_columns(frame, study)
    lines = [
        name
        for name in study.lines or frame.attrs['factors']
        if name not in (*NOT_FACTORS, *study.sections)
        and frame[name].astype(str).ne('').any()
    ]
    heads = [_head(frame, study, name) for name in lines]
    by = [name for name in study.sections if frame[name].nunique() > 1]
    listing = {}
    for title, section in _groups(frame, by):
        shown = pd.DataFrame(
            [
                {
                    **dict(zip(heads, map(show, label))),
                    **{column.name: _cell(column, group, study) for column in columns},
                }
                for label, group in _groups(section, lines)
            ]
        )
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
    varied = [
        name
        for name in frame.attrs['factors']
        if name not in NOT_FACTORS and frame[name].nunique() > 1
    ]
    subject = [
        name for name in varied if not pd.api.types.is_numeric_dtype(frame[name])
    ][:1]
    alike: dict[str, list[str]] = {}
    for (plant, *who), runs in _groups(frame, ['plant', *subject]):
        good = runs[study.truth]
        where = '; '.join(
            f'{head} = {values} {unit}'.rstrip()
            for name in varied
            if name not in subject
            and runs[name].nunique() > 1
            and (values := good_values(runs, name, study.truth)) != 'none'
            for head, _, unit in [_head(frame, study, name).rstrip(']').partition(' [')]
        )
        count = 'all runs' if good.all() else f'{int(good.sum())} of {len(runs)} runs'
        also = '' if good.all() else 'in every run '
        alike.setdefault(
            f'{study.truth} on {plant} in {count}'
            + (f', {also}with {where}' if where else ''),
            [],
        ).extend(who or ['The arm'])
    return [
        f'{", ".join(map(str, names))} {"are" if len(names) > 1 else "is"} {text}.'
        for text, names in alike.items()
    ]


def good_values(frame: pd.DataFrame, factor: str, truth: str) -> str:
    """Return the values of a factor at which all runs are good: a range, a list, or `none`."""
    known = frame[frame[factor].astype(str).ne('')]
    good = known.groupby(factor)[truth].all()
    values, places = [show(value) for value in good.index[good]], np.flatnonzero(good)
    if len(values) > 3 and len(values) == places[-1] - places[0] + 1:
        values = [f'{values[0]} to {values[-1]}']
    return ', '.join(values) or 'none'


def _groups(
    frame: pd.DataFrame, by: Sequence[str]
) -> Iterable[tuple[Any, pd.DataFrame]]:
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
        return (
            f'{int(values.sum())}/{len(values)}'
            if column.aggregate == 'share'
            else (', '.join(sorted(set(map(str, values)))) or '-')
        )
    numbers = columns_of(cells, column.value)
    if column.each:
        return (
            ' / '.join(
                _number(numbers[name], column)
                for name in numbers.dropna(axis=1, how='all')
            )
            or '-'
        )
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


class Series(NamedTuple):
    """Runs that are one series of points in every panel of a figure."""

    label: str
    runs: pd.DataFrame
    style: Mapping[str, Any]


def _columns_that_fit(frame: pd.DataFrame, width: int) -> list[list[str]]:
    """Return the columns beside the labels, as many together as fit into a width."""
    labels = list(frame)[: frame.attrs['labels']]
    room = {
        name: 2 + max(*map(len, _head_lines(name)), *frame[name].map(len))
        for name in frame
    }
    of_labels = sum(room[name] for name in labels)
    parts: list[list[str]] = []
    used = width
    for name in list(frame)[len(labels) :]:
        if used + room[name] >= width:
            parts.append([])
            used = of_labels
        parts[-1].append(name)
        used += room[name]
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
        text.add_column(
            escape('\n'.join(_head_lines(name))),
            overflow='fold',
            justify='left' if name in labels else 'right',
        )
    for line in shown.itertuples(index=False):
        text.add_row(*map(escape, line))
    return text


def _head_lines(name: str) -> list[str]:
    """Return the head of a column, a word on each line."""
    return re.split(r' (?![^[]*\]|/)', name)


def draw_study(frame: pd.DataFrame, study: StudyConfig) -> Figure | None:
    """
    Return the figure of a study, a panel for each plant and each value that varies.

    Points are medians of the good runs over the first factor, or the share of good runs, for each
    part and value of the second factor; a cross stands where no run is good. Names of a first
    factor are lines, its numbers an axis. None without a factor or a value to draw.
    """
    names = [name for name in frame.attrs['factors'] if name not in NOT_FACTORS]
    columns = [
        column
        for column in table_columns(frame, study)
        if column.aggregate in ('median', 'share')
        and worst(frame, column.value).nunique() > 1
    ][:MOST_SHOWN]
    if not (study.figure and names and columns):
        return None
    lines = ['part'] if frame['part'].nunique() > 1 else []
    lines += names[1:2] or ['part'] * (not lines)
    series = series_of(frame, study, lines)
    draw = (
        _draw_numbers if pd.api.types.is_numeric_dtype(frame[names[0]]) else _draw_names
    )
    figure = draw(frame, study, names[0], columns, series)
    shown: dict[str, Any] = {}
    for axes in figure.axes:
        for line, label in zip(*axes.get_legend_handles_labels()):
            shown.setdefault(label, line)
    if not frame.groupby([names[0], 'plant', *lines])[study.truth].any().all():
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


def series_of(
    frame: pd.DataFrame, study: StudyConfig, lines: Sequence[str]
) -> list[Series]:
    """Return the runs by part and value of the second factor, each with its name and look."""
    series = []
    for number, (values, runs) in enumerate(_groups(frame, lines)):
        words = []
        for name, value in zip(lines, values):
            head, _, unit = _head(frame, study, name).rstrip(']').partition(' [')
            text = show(value)
            words.append(text if name == 'part' else f'{head} = {text} {unit}'.strip())
        series.append(
            Series(
                ', '.join(words),
                runs,
                {
                    'color': CURVE_COLOURS[number % len(CURVE_COLOURS)],
                    'marker': MARKERS[number % len(MARKERS)],
                    'markersize': 5,
                },
            )
        )
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
            runs = each.runs[each.runs['plant'] == plant]
            values, good = _points(runs, factor, column, study)
            values = values.sort_index()
            axes.plot(
                values.index, values, '-', alpha=0.8, label=each.label, **each.style
            )
            for value in _not_drawn(good, column):
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
        axes.set_ylabel(_title(column), fontsize=8)
        axes.set_xlabel(_head(frame, study, factor), fontsize=8)
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
    names = {
        plant: list(runs[factor].unique())
        for plant, runs in frame.groupby('plant', sort=False)
    }
    room = 0.25 + ROOM_OF_SERIES * len(series)  # inches, of a name
    heights = [room * len(known) + 0.3 for known in names.values()]
    figure = Figure(
        figsize=(2.4 * len(columns) + 2.0, sum(heights) + 1.3), layout='constrained'
    )
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
        here = [
            each._replace(runs=each.runs[each.runs['plant'] == plant])
            for each in series
        ]
        places = _places(here, factor, known)
        for each in here:
            values, good = _points(each.runs, factor, column, study)
            axes.plot(
                values,
                [places[name, each.label] for name in values.index],
                linestyle='',
                label=each.label,
                **each.style,
            )
            for name in _not_drawn(good, column):
                axes.plot(
                    0.0,
                    places[name, each.label],
                    transform=axes.get_yaxis_transform(),
                    color=each.style['color'],
                    **CROSS,
                )
        for place in range(0, len(known), 2):
            axes.axhspan(place - 0.5, place + 0.5, color='#f4f5f7', zorder=0)
        axes.set_yticks(
            range(len(known)), [fill(str(name), NAME_WIDTH) for name in known]
        )
        axes.set_ylim(len(known) - 0.5, -0.5)
        axes.set_xlabel(_title(column), fontsize=9)
        axes.tick_params(labelsize=9)
        axes.grid(axis='x', alpha=0.4)
        axes.label_outer()
    for axes, plant in zip(grid[:, 0], names):
        axes.set_title(f'plant {plant}', fontsize=10, loc='left')
    return figure


def _places(
    series: Sequence[Series],
    factor: str,
    names: Sequence[Any],
) -> dict[tuple[Any, str], float]:
    """Return where each series of each name lies: beside each other, around the name's place."""
    places = {}
    for place, name in enumerate(names):
        there = [each.label for each in series if (each.runs[factor] == name).any()]
        for number, label in enumerate(there):
            places[name, label] = place + SPREAD * ((number + 0.5) / len(there) - 0.5)
    return places


def _not_drawn(good: pd.Series, column: ColumnConfig) -> list[Any]:
    """Return where no run is good, which a median leaves out."""
    return [] if column.aggregate == 'share' else list(good.index[~good])


def _title(column: ColumnConfig) -> str:
    name = column.name.replace('*', 'worst').replace('.', '\n')
    return f'share of {name} runs' if column.aggregate == 'share' else name


def _points(
    runs: pd.DataFrame,
    factor: str,
    column: ColumnConfig,
    study: StudyConfig,
) -> tuple[pd.Series, pd.Series]:
    """Return what is drawn of runs by the value of a factor, and whether any of them is good."""
    drawn, statistic = worst(runs, column.value), 'mean'
    if column.aggregate == 'median':
        drawn = column.scale * drawn.where(runs[study.truth] & np.isfinite(drawn))
        statistic = 'median'
    by_value = runs.assign(drawn=drawn).groupby(factor, sort=False)
    return by_value['drawn'].agg(statistic), by_value[study.truth].any()
