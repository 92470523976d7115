"""The forces behind every line of a comparison's table, drawn where the page is looked at."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.experiment.judge import verdict_text
from multicontact_control.experiment.page import (
    COMMANDED,
    ESTIMATED,
    figure,
    FILLED,
    OPEN,
    Panel,
    plot,
    script_json,
    Trace,
    TRUE,
)
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.presets.compare.matrix import AOB, PLAIN
import numpy as np

SAMPLES = 40_000  # of all runs together, each of its figures; what is more is thinned out
FEWEST = 500  # of a run
HEIGHT, LOWEST = 190, 150  # px, of forces and of R
GOOD, BAD = '#18794e', '#c0262d'
APART = 0.12  # points of one label, from seed to seed
NOTE = """
<p class=note>Errors are those of the true contact forces. Each line is the median over the seeds,
of the worse contact. <b>rest</b> and <b>moving</b> leave out the pushes; <b>never</b>: a push was
not controlled out before the next event. docs/experiments.md says what counts as a recovery and
as unstable. Click a line for its forces; drag over them to zoom in, double click to see all
again.</p>
"""
SCRIPT = """
const RUNS = %s;
const plantOf = row => RUNS[row.dataset.keys.split(' ')[0]].plant;
function show(plant, keys, index, line) {
  drawFigure(document.getElementById('forces-' + plant), RUNS[keys[index]].plots);
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
    longest = max(FEWEST, 2 * (SAMPLES // (2 * max(len(rows), 1))))
    return SCRIPT % script_json({row['key']: _forces(row, cache, longest) for row in rows})


def forces_of_plant(rows: Sequence[dict[str, Any]], plant: str, number: int) -> str:
    """Return the HTML in which the script draws, and the errors of all runs of a plant."""
    return (f'<div id="seeds-{escape(plant)}"></div>{figure(f"forces-{plant}")}'
            f'{_overview(rows, plant, number)}')


def _forces(row: dict[str, Any], cache: JobCache, longest: int) -> dict[str, Any]:
    """Return the forces of one run and its R, each contact in a plot, as `drawFigure` has it."""
    result = cache.load(row['key'])
    if result is None:
        raise RunError(f'{cache.folder}/{row["key"]}: expected a finished job')
    traces, names = result.traces, row['contacts']
    plots = []
    for i, name in enumerate(names):
        desired = traces['desired'][:, i]
        top = 3.0 * float(np.max(desired[np.isfinite(desired)], initial=0.0))
        plots.append(plot(Panel(f'{name} [N]', (
            Trace('true', traces['true'][:, i], TRUE),
            Trace('estimated', traces['estimated'][:, i], ESTIMATED),
            Trace('commanded', desired, COMMANDED, dashed=True)),
            (-2.0, top) if top > 0.0 else None), traces['time'], longest=longest, height=HEIGHT))
    plots.append(plot(Panel('R [N²]', [
        Trace(f'R {name}', traces['variance'][:, i], None) for i, name in enumerate(names)],
        logarithmic=True), traces['time'], longest=longest, height=LOWEST))
    size = plots[0]['thinned']
    drawn = '' if size == 1 else f'; smallest and largest of every {size} samples'
    plots[0]['heading'] = (f'{row["plant"]}, {row["label"]}, {row["kind"]}, seed {row["seed"]}: '
                           f'{verdict_text(row["evidence"])}{drawn}')
    return {'plant': row['plant'], 'seed': row['seed'], 'plots': plots}


def _overview(rows: Sequence[dict[str, Any]], plant: str, number: int) -> str:
    """Return the force errors in motion as points, one for each run."""
    chosen = [row for row in rows if row['plant'] == plant and row['kind'] in (AOB, PLAIN)
              and row['moving_rms_n'] is not None]
    labels = list(dict.fromkeys(row['label'] for row in chosen))
    places = {row['key']: labels.index(row['label']) + APART * (row['seed'] % 3 - 1)
              for row in chosen}
    chosen.sort(key=lambda row: places[row['key']])
    across = np.array([places[row['key']] for row in chosen])
    errors = np.array([row['moving_rms_n'] for row in chosen])
    traces = []
    for kind, marker in ((AOB, FILLED), (PLAIN, OPEN)):
        for stable, colour in ((True, GOOD), (False, BAD)):
            those = [row['kind'] == kind and bool(row['stable']) is stable for row in chosen]
            traces.append(Trace(f'{kind}, {"stable" if stable else "not stable"}',
                                np.where(those, errors, np.nan), colour, marker=marker))
    known = [trace for trace in traces if np.isfinite(trace.values).any()]
    return figure(f'overview-{number}', [plot(
        Panel('rms [N]', known, logarithmic=True), across,
        'True force error in motion, every run', places=labels)]) if known else ''
