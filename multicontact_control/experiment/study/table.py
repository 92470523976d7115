"""The tables of a study: as files, in the terminal, and on its page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from multicontact_control.experiment.page import table
from multicontact_control.files import replacing, write_json, write_text
import pyarrow.parquet as pq
from rich.box import SIMPLE_HEAD
from rich.markup import escape as plain
from rich.table import Table
import yaml

WIDE = 110  # columns of a terminal that has room for every column of a table
LONGEST = 1000  # lines of a table on a page


def write_table(content: Any, path: Path) -> Path:
    """
    Write a table such that a reader sees the old file or the new one, never half of one.

    Parameters
    ----------
    content
        A `pyarrow.Table` for ``.parquet``; JSON values for ``.json`` and ``.yaml``.
    path
        Its suffix says what is written.

    """
    if path.suffix == '.parquet':
        with replacing(path) as partial:
            pq.write_table(content, partial, compression='zstd')
    elif path.suffix == '.yaml':
        write_text(path, yaml.safe_dump(content, sort_keys=False))
    else:
        write_json(path, content)
    return path


@dataclass(frozen=True)
class Column:
    """A column of what is shown."""

    head: str  # on the page
    short: str | None = None  # in the terminal; the head if None
    number: bool = True  # set to the right
    spare: bool = False  # a narrow terminal does without it


@dataclass(frozen=True)
class Line:
    """A line of what is shown."""

    cells: Sequence[str]  # plain text
    good: bool | None = None  # colours the cell that says so
    group: str = ''  # stands above the first of the lines that have it in common
    html_attributes: str = ''


@dataclass(frozen=True)
class Listing:
    """A table to be looked at."""

    columns: Sequence[Column]
    lines: Sequence[Line]
    verdict: int = 1  # place of the cell that says whether a line is good
    caption: str = ''  # below it in the terminal


def format_number(value: float | None, digits: int, scale: float = 1.0) -> str:
    """Return a number times a scale for a cell, a dash for one that is not known."""
    return '-' if value is None else f'{scale * value:.{digits}f}'


def short_names(names: Sequence[str], separator: str = '.') -> list[str]:
    """Return the last parts of names, as many as it takes to tell them apart."""
    short = []
    for name in names:
        parts = name.split(separator)
        count = next(n for n in range(1, len(parts) + 1) if n == len(parts) or sum(
            other.split(separator)[-n:] == parts[-n:] for other in names) == 1)
        short.append(separator.join(parts[-count:]))
    return short


def terminal_table(title: str, listing: Listing, width: int) -> Table:
    """Return a listing for a terminal of some width; a narrow one does without some columns."""
    shown = [i for i, column in enumerate(listing.columns) if width >= WIDE or not column.spare]
    found = Table(title=plain(title), box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False,
                  caption=plain(listing.caption) or None)
    for i in shown:
        column = listing.columns[i]
        found.add_column(plain(column.head if column.short is None else column.short),
                         justify='right' if column.number else 'left', overflow='fold',
                         no_wrap=column.number and column.short is not None)
    group = ''
    for line in listing.lines:
        if line.group != group:
            group = line.group
            found.add_section()
            found.add_row(f'[bold]{plain(group)}[/bold]')
        cells = [plain(cell) for cell in line.cells]
        if line.good is not None:
            colour = 'green' if line.good else 'red'
            cells[listing.verdict] = f'[{colour}]{cells[listing.verdict]}[/{colour}]'
        found.add_row(*(cells[i] for i in shown))
    return found


def html_table(listing: Listing) -> str:
    """Return a listing as HTML; of a very long one the beginning."""
    rows: list[list[str]] = []
    attributes: list[str] = []
    group = ''
    for line in listing.lines[:LONGEST]:
        if line.group != group:
            group = line.group
            rows.append([f'<b>{escape(group)}</b>', *[''] * (len(listing.columns) - 1)])
            attributes.append('')
        cells = [escape(cell) for cell in line.cells]
        if line.good is not None:
            colour = 'yes' if line.good else 'no'
            cells[listing.verdict] = f'<b class={colour}>{cells[listing.verdict]}</b>'
        rows.append(cells)
        attributes.append(line.html_attributes)
    numbers = [i for i, column in enumerate(listing.columns) if column.number]
    text = table([escape(column.head) for column in listing.columns], rows,
                 numbers_from=numbers[0] if numbers else len(listing.columns),
                 row_attributes=attributes)
    left = len(listing.lines) - LONGEST
    return text + (f'<p class=note>{left} more lines are left out.</p>' if left > 0 else '')
