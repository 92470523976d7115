"""``comparison.html``: the table of the matrix, and the forces behind every cell of it."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.experiment.comparison.findings import findings
from multicontact_control.experiment.comparison.matrix import AOB, CAUSE, PLAIN
from multicontact_control.experiment.comparison.rows import comparison_claims, grouped
from multicontact_control.experiment.comparison.table import table_row
from multicontact_control.experiment.engine import CellResult, CellStore
from multicontact_control.experiment.html import (
    claims_table,
    corners,
    envelope,
    figure,
    script_json,
    table,
    write_page,
)
from multicontact_control.experiment.verdict import verdict_text
from rich.text import Text

PAGE_FILE = 'comparison.html'
FORCE_BUCKETS = 250
VARIANCE_BUCKETS = 80
HEAD = ('estimator', 'stable', 'unstable after motion start [s]', 'rest rms [N]',
        'moving rms [N]', 'contact lost moving [%]', 'R rest [N²]', 'R moving [N²]',
        'recovery, push 0.1 s [s]', 'recovery, push 1 s [s]', 'torque [% of limit]')
NOTE = """
<p class=note>Errors are those of the true contact forces. Each line is the median over the seeds,
of the worse contact. <b>rest</b> and <b>moving</b> leave out each push and 1 s after it.
<b>recovery</b>: time until |true &minus; desired| is within 5 % of the command, or within three
standard deviations of its own value in the second before the push, whichever is larger, and stays
there for 0.1 s; from the end of the push of 0.1 s, from the start of the push of 1 s, which is to
be controlled out while it lasts; <b>never</b> if not before the next event. Unstable: torque
saturated or a contact lost for more than 0.1 s, a contact lost more than 5 times in 10 s, a force
that oscillates for 2 s, or one beyond 5 times its command and half the force ceiling.
Click a line for its forces.</p>
"""
SCRIPT = """
const CELLS = %s;
function show(plant, keys, index, line) {
  const cell = CELLS[keys[index]], names = Object.keys(cell.contacts), traces = [];
  names.forEach((name, i) => {
    const c = cell.contacts[name], axis = 'y' + (i ? i + 1 : '');
    const add = (series, label, colour, dash, width) => traces.push({
      x: c[series][0], y: c[series][1], name: name + ' ' + label, yaxis: axis, mode: 'lines',
      line: {color: colour, dash: dash, width: width}});
    add('true', 'true', '#e45756', 'solid', 1);
    add('estimated', 'estimated', '#54a24b', 'solid', 1);
    add('desired', 'commanded', '#222', 'dash', 1.2);
    traces.push({x: c.variance[0], y: c.variance[1], name: name + ' R', mode: 'lines',
      yaxis: 'y' + (names.length + 1), line: {width: 1}});
  });
  const layout = {height: 640, margin: {t: 40, l: 60, r: 10, b: 40}, hovermode: 'x',
    title: {text: cell.title, font: {size: 13}}, xaxis: {title: {text: 'time [s]'},
    anchor: 'y' + (names.length + 1)}, legend: {orientation: 'h', y: -0.12}};
  const rows = names.length + 1;
  names.concat(['R']).forEach((name, i) => {
    const axis = 'yaxis' + (i ? i + 1 : '');
    layout[axis] = {domain: [1 - (i + 1) / rows + 0.03, 1 - i / rows],
      title: {text: name == 'R' ? 'R [N²]' : name + ' [N]'}, type: name == 'R' ? 'log' : 'linear'};
    if (name != 'R' && cell.top[name]) layout[axis].range = [-2, cell.top[name]];
  });
  Plotly.react('forces-' + plant, traces, layout, {responsive: true, displaylogo: false});
  const buttons = document.getElementById('seeds-' + plant);
  buttons.replaceChildren(...keys.map((key, i) => {
    const button = document.createElement('button');
    button.textContent = 'seed ' + CELLS[key].seed;
    button.disabled = i == index;
    button.onclick = () => show(plant, keys, i, line);
    return button;
  }));
  document.querySelectorAll('tr[data-plant="' + plant + '"]').forEach(
    row => row.classList.toggle('chosen', row === line));
}
document.querySelectorAll('tr.choice').forEach(row => {
  row.onclick = () => show(row.dataset.plant, row.dataset.keys.split(' '), 0, row);
});
document.querySelectorAll('tr.first').forEach(row => row.click());
"""


def write_comparison_page(content: dict[str, Any], folder: Path, extra: str = '') -> Path:
    """
    Write ``comparison.html``.

    Parameters
    ----------
    content
        Of ``comparison.json``.
    folder
        Where the cells are, and the page goes.
    extra
        HTML that goes before the claims, e.g. the robustness map.

    Returns
    -------
    Path
        The file.

    """
    rows = content['rows']
    store = CellStore(folder)
    plants = list(dict.fromkeys(row['plant'] for row in rows))
    said = findings(rows)
    parts = ['<h2>What came out</h2><ul>', *(f'<li>{escape(text)}</li>' for text in said), '</ul>']
    for number, plant in enumerate(plants):
        parts.append(f'<h2>Plant {escape(plant)}</h2>{NOTE if not number else ""}')
        parts.append(_table(rows, plant))
        parts.append(f'<div id="seeds-{escape(plant)}"></div>'
                     f'<div id="forces-{escape(plant)}"></div>')
        parts.append(_overview(rows, plant, number))
    parts.append(extra)
    for plant, claims in comparison_claims(rows).items():
        parts.append(f'<h2>Claims of the paper, plant {escape(plant)}</h2>')
        parts.append(claims_table(claims))
    cells = {row['key']: _cell(row, store) for row in rows}
    parts.append(f'<script>{SCRIPT % script_json(cells)}</script>')
    path = folder / PAGE_FILE
    write_page(path, f'Noise estimators compared: scenario {content["scenario"]}',
               '\n'.join(parts))
    return path


def _table(rows: Sequence[dict[str, Any]], plant: str) -> str:
    lines: list[list[str]] = []
    attributes: list[str] = []
    for (where, kind, label), group in grouped(rows).items():
        if where != plant:
            continue
        lines.append(plain_cells(kind, label, group))
        first = '' if attributes else ' first'
        keys = ' '.join(row['key'] for row in group)
        attributes.append(f'class="choice{first}" data-plant="{escape(plant)}" '
                          f'data-keys="{keys}"')
    return table(HEAD, lines, row_attributes=attributes)


def plain_cells(kind: str, label: str, group: Sequence[dict[str, Any]]) -> list[str]:
    """Return one line of the table as HTML."""
    cells = [Text.from_markup(cell).plain for cell in table_row(label, group)]
    colour = 'yes' if all(row['stable'] for row in group) else 'no'
    name = cells[0] if kind in cells[0] or kind in (AOB, CAUSE) else f'{cells[0]}, {kind}'
    return [escape(name), f'<b class={colour}>{cells[1]}</b>', *map(escape, cells[2:])]


def _cell(row: dict[str, Any], store: CellStore) -> dict[str, Any]:
    """Return the thinned-out forces of one cell."""
    result = store.load(row['key'])
    if result is None:
        raise RunError(f'{store.folder}/{row["key"]}: expected a finished cell')
    contacts, top = {}, {}
    for i, name in enumerate(row['contacts']):
        contacts[name] = _series(result, i)
        top[name] = 3.0 * float(result.traces['desired'][:, i].max())
    return {'title': f'{row["plant"]}, {row["label"]}, {row["kind"]}, seed {row["seed"]}: '
                     f'{verdict_text(row)}',
            'seed': row['seed'], 'contacts': contacts, 'top': top}


def _series(result: CellResult, contact: int) -> dict[str, Any]:
    traces = result.traces
    time = traces['time']
    return {
        'true': envelope(time, traces['true'][:, contact], FORCE_BUCKETS),
        'estimated': envelope(time, traces['estimated'][:, contact], FORCE_BUCKETS),
        'desired': corners(time, traces['desired'][:, contact]),
        'variance': envelope(time, traces['variance'][:, contact], VARIANCE_BUCKETS)}


def _overview(rows: Sequence[dict[str, Any]], plant: str, number: int) -> str:
    """Return the force errors in motion as points, one for each run."""
    traces = []
    for kind, symbol in ((AOB, 'circle'), (PLAIN, 'diamond-open')):
        chosen = [row for row in rows if row['plant'] == plant and row['kind'] == kind
                  and row['moving_rms_n'] is not None]
        traces.append({
            'x': [row['label'] for row in chosen],
            'y': [round(row['moving_rms_n'], 4) for row in chosen], 'mode': 'markers',
            'name': kind, 'marker': {'symbol': symbol, 'size': 9, 'color': [
                '#18794e' if row['stable'] else '#c0262d' for row in chosen]}})
    return figure(f'overview-{number}', traces, {
        'height': 300, 'margin': {'t': 30, 'b': 60, 'l': 60, 'r': 10},
        'title': {'text': 'True force error in motion, every run; red: not stable',
                  'font': {'size': 13}},
        'yaxis': {'type': 'log', 'title': {'text': 'rms [N]'}}})
