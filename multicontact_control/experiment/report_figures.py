"""The paper's Figures 3-6 as interactive figures of a page."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.figures import COMMANDED, ESTIMATED, MEASURED, TRUE
from multicontact_control.experiment.html_parts import corners, envelope, figure
from multicontact_control.experiment.load import LoadedRun
from multicontact_control.experiment.metrics import windows
import numpy as np

BUCKETS = 1500
TITLE_FONT = {'size': 14}


def interactive_figures(run: LoadedRun, number: int) -> str:
    """
    Return the figures of a run as HTML.

    Parameters
    ----------
    run
        What was recorded.
    number
        Of the run on the page, for the names of the figures.

    """
    parts = []
    for i, name in enumerate(run.data.contact_names):
        parts.append(figure(f'run{number}-force{i}', _forces(run, i), _layout(
            run, f'Fig. {3 + i if i < 2 else "3/4"}: contact force {name}', 'force [N]',
            top=1.6 * max(float(np.nanmax(run.data.alpha_des[:, i])), 5.0))))
    traces, label = _motion(run)
    parts.append(figure(f'run{number}-motion', traces, _layout(
        run, f'Fig. 5: wrist motion along {label}', f'{label} [m]')))
    layout = _layout(run, 'Fig. 6: estimated noise variance', 'R [N²]')
    layout['yaxis']['type'] = 'log'
    layout['shapes'] += [
        {'type': 'line', 'xref': 'paper', 'x0': 0, 'x1': 1, 'y0': level, 'y1': level,
         'line': {'color': COMMANDED, 'width': 1, 'dash': 'dot'}} for level in (0.6, 100.0)]
    parts.append(figure(f'run{number}-variance', [
        _line(run.data.time, run.data.noise_variance[:, i], name)
        for i, name in enumerate(run.data.contact_names)], layout))
    return '\n'.join(parts)


def _line(
    time: Vector, values: Vector, name: str, colour: str | None = None, *, steps: bool = False,
    **line: Any,
) -> dict[str, Any]:
    x, y = corners(time, values) if steps else envelope(time, values, BUCKETS)
    style = {'width': 1, **({'color': colour} if colour else {}), **line}
    return {'x': x, 'y': y, 'name': name, 'mode': 'lines', 'line': style}


def _forces(run: LoadedRun, i: int) -> list[dict[str, Any]]:
    data = run.data
    return [_line(data.time, data.alpha_meas[:, i], 'measured', MEASURED),
            _line(data.time, data.alpha_true[:, i], 'true', TRUE),
            _line(data.time, data.alpha_est[:, i], 'estimated (AOB)', ESTIMATED),
            _line(data.time, data.alpha_des[:, i], 'commanded', COMMANDED,
                  steps=True, dash='dash')]


def _motion(run: LoadedRun) -> tuple[list[dict[str, Any]], str]:
    motion = run.setup.scenario.reference.motion
    direction = np.asarray(motion.direction_world if motion else (1.0, 0.0, 0.0))
    data = run.data
    return ([_line(data.time, data.position @ direction, 'measured', MEASURED),
             _line(data.time, data.position_des @ direction, 'commanded', COMMANDED,
                   dash='dash')], 'xyz'[int(np.argmax(np.abs(direction)))])


def _layout(
    run: LoadedRun, title: str, label: str, *, top: float | None = None,
) -> dict[str, Any]:
    judged = windows(run.setup.scenario.reference, run.data.time)
    shapes = []
    for window in (judged.rest, judged.moving):
        if window.any():
            times = run.data.time[window]
            shapes.append({
                'type': 'rect', 'yref': 'paper', 'y0': 0, 'y1': 1, 'x0': float(times[0]),
                'x1': float(times[-1]), 'fillcolor': '#f2f2f2', 'line': {'width': 0},
                'layer': 'below'})
    axis: dict[str, Any] = {'title': {'text': label}}
    if top is not None:
        axis['range'] = [-2.0, top]
    return {'title': {'text': title, 'font': TITLE_FONT}, 'height': 340, 'hovermode': 'x',
            'margin': {'t': 40, 'b': 40, 'l': 60, 'r': 10}, 'shapes': shapes, 'yaxis': axis,
            'xaxis': {'title': {'text': 'time [s]'}}}
