"""The forces behind every line of a comparison's table, drawn where the page is looked at."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.experiment.html_parts import corners, envelope, figure, script_json
from multicontact_control.experiment.judge import verdict_text
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.jobs import JobResult
from multicontact_control.experiment.study.presets.compare.matrix import AOB, PLAIN

FORCE_BUCKETS = 250
VARIANCE_BUCKETS = 80
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
const RUNS = %s;
const plantOf = row => RUNS[row.dataset.keys.split(' ')[0]].plant;
function show(plant, keys, index, line) {
  const run = RUNS[keys[index]], names = Object.keys(run.contacts), traces = [];
  names.forEach((name, i) => {
    const c = run.contacts[name], axis = 'y' + (i ? i + 1 : '');
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
    title: {text: run.title, font: {size: 13}}, xaxis: {title: {text: 'time [s]'},
    anchor: 'y' + (names.length + 1)}, legend: {orientation: 'h', y: -0.12}};
  const rows = names.length + 1;
  names.concat(['R']).forEach((name, i) => {
    const axis = 'yaxis' + (i ? i + 1 : '');
    layout[axis] = {domain: [1 - (i + 1) / rows + 0.03, 1 - i / rows],
      title: {text: name == 'R' ? 'R [N²]' : name + ' [N]'}, type: name == 'R' ? 'log' : 'linear'};
    if (name != 'R' && run.top[name]) layout[axis].range = [-2, run.top[name]];
  });
  Plotly.react('forces-' + plant, traces, layout, {responsive: true, displaylogo: false});
  const buttons = document.getElementById('seeds-' + plant);
  buttons.replaceChildren(...keys.map((key, i) => {
    const button = document.createElement('button');
    button.textContent = 'seed ' + RUNS[key].seed;
    button.disabled = i == index;
    button.onclick = () => show(plant, keys, i, line);
    return button;
  }));
  document.querySelectorAll('tr.choice').forEach(row => {
    if (plantOf(row) == plant) row.classList.toggle('chosen', row === line);
  });
}
document.querySelectorAll('tr.choice').forEach(row => {
  row.onclick = () => show(plantOf(row), row.dataset.keys.split(' '), 0, row);
});
document.querySelectorAll('tr.first').forEach(row => row.click());
"""


def forces_script(rows: Sequence[dict[str, Any]], cache: JobCache) -> str:
    """Return the script that draws the forces of a line that is clicked, with the forces."""
    return SCRIPT % script_json({row['key']: _forces(row, cache) for row in rows})


def forces_of_plant(rows: Sequence[dict[str, Any]], plant: str, number: int) -> str:
    """Return the HTML in which the script draws, and the errors of all runs of a plant."""
    return (f'<div id="seeds-{escape(plant)}"></div><div id="forces-{escape(plant)}"></div>'
            f'{_overview(rows, plant, number)}')


def _forces(row: dict[str, Any], cache: JobCache) -> dict[str, Any]:
    """Return the thinned-out forces of one run."""
    result = cache.load(row['key'])
    if result is None:
        raise RunError(f'{cache.folder}/{row["key"]}: expected a finished job')
    contacts, top = {}, {}
    for i, name in enumerate(row['contacts']):
        contacts[name] = _series(result, i)
        top[name] = 3.0 * float(result.traces['desired'][:, i].max())
    return {'title': f'{row["plant"]}, {row["label"]}, {row["kind"]}, seed {row["seed"]}: '
                     f'{verdict_text(row)}',
            'plant': row['plant'], 'seed': row['seed'], 'contacts': contacts, 'top': top}


def _series(result: JobResult, contact: int) -> dict[str, Any]:
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
