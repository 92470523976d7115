"""The passes of a run on its page: their table, and the maps of the force."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
import math
from pathlib import Path
from typing import NamedTuple

from multicontact_control.judging import page
from multicontact_control.judging.passes import FORCE_BAND
from multicontact_control.judging.path_maps import MAP_PREFIX
from multicontact_control.judging.run_folders import PASSES_FILE, PASSES_TABLE
import pandas as pd


class PassColumn(NamedTuple):
    """A column of the table of passes on the page: which of the file, its head, and its unit."""

    name: str
    head: str
    digits: int = 2  # behind the point
    scale: float = 1.0  # from the unit of the file to that of the head

    def describe(self, value: float | str) -> str:
        """Return what stands in a cell, in HTML."""
        if isinstance(value, str):
            return escape(value)
        if math.isnan(value):
            return '-'
        return f'{value * self.scale:.{self.digits}f}'


PASS_COLUMNS = (
    PassColumn('pass', 'pass', 0),
    PassColumn('contact', 'contact'),
    PassColumn('begin_s', 'begin [s]'),
    PassColumn('end_s', 'end [s]'),
    PassColumn('length_m', 'length [mm]', 1, 1e3),
    PassColumn('mean_speed_m_s', 'speed [mm/s]', 1, 1e3),
    PassColumn('command_mean_n', 'command [N]'),
    PassColumn('force_mean_n', 'mean [N]'),
    PassColumn('force_std_n', 'std [N]'),
    PassColumn('force_min_n', 'least [N]'),
    PassColumn('force_max_n', 'largest [N]'),
    PassColumn('outside_band_share', f'off by {FORCE_BAND:.0%} [% of time]', 1, 100.0),
    PassColumn('no_contact_share', 'no contact [% of time]', 1, 100.0),
    PassColumn('friction_work_all_contacts_j', 'work of friction, all [J]', 3),
)
PASSES_NOTE = (
    f'Each row is a contact on a stretch of the path between two turns; the same is in '
    f'<code>{PASSES_FILE}</code> and <code>{PASSES_TABLE}</code>. The work of friction is that '
    'of all contacts together. In the maps a cross is a place without contact.'
)


def render_passes(table: pd.DataFrame, drawn: Sequence[Path]) -> str:
    """
    Return the passes of a run in HTML: table and maps; nothing of a run without a path.

    Parameters
    ----------
    table
        What `write_passes` has returned.
    drawn
        The figures of the run, the maps among them.

    """
    if table.empty:
        return ''
    rows = []
    for values in table.to_dict('records'):
        rows.append([column.describe(values[column.name]) for column in PASS_COLUMNS])
    heads = [escape(column.head) for column in PASS_COLUMNS]
    shown = page.render_table(heads, rows, numbers_from=2)
    parts = [
        '<h3>Passes along the path</h3>',
        f'<div class=scroll>{shown}</div>',
        f'<p class=note>{PASSES_NOTE}</p>',
    ]
    for path in drawn:
        if path.name.startswith(MAP_PREFIX) and path.suffix == '.png':
            parts.append(page.render_image(path, 'map of the force along the path'))
    return '\n'.join(parts)
