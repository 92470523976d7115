"""Figures on a page: their samples are in it, packed, and drawn where the page is looked at."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from html import escape
import json
from pathlib import Path
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.experiment.packing import envelope, pack
from multicontact_control.experiment.panels import COLOURS, Panel, Span, Trace, WINDOW

ASSETS = Path(__file__).parent / 'page_assets'
SCRIPTS = ('uPlot.iife.min.js', 'figures.js')
STYLES = ('uPlot.min.css',)
LICENSE = 'uPlot.LICENSE'  # goes with every copy
LONGEST = 200_000  # samples of a figure; what is longer is thinned out
HEIGHT = 300  # px, without title and legend
HELP = ('<p class=note>Drag over a figure to zoom into all of them, double click to see all '
        'again; click a name to hide its curve. Unless something else is said below a figure, '
        'every sample is in this page, rounded to 1/4096 of what its curve spans.</p>')


def plot(
    panel: Panel, time: Vector, heading: str = '', *, shaded: Sequence[Span] = (),
    height: int = HEIGHT, longest: int = LONGEST, places: Sequence[str] = (),
) -> dict[str, Any]:
    """
    Return what figures.js draws, as JSON values.

    Parameters
    ----------
    panel
        What is drawn.
    time
        Of its samples, shape (m,) [s].
    heading
        Above it, plain text.
    shaded
        Stretches with their names.
    height
        Of axes and curves [px].
    longest
        Samples that are drawn at most, see `envelope`.
    places
        What stands along the horizontal axis at 0, 1, ... instead of time.

    """
    thinned, series, size = envelope(time, [trace.values for trace in panel.traces], longest)
    return {
        'heading': heading, 'label': panel.label, 'height': height, 'places': list(places),
        'xlabel': '' if places else 'time [s]', 'limits': panel.limits,
        'logarithmic': panel.on_log_axis, 'levels': panel.levels, 'thinned': size,
        'shaded': [list(span) for span in shaded], 'shade': WINDOW,
        'curves': [_style(trace, i) for i, trace in enumerate(panel.traces)],
        'packed': pack(thinned, series, logarithmic=panel.on_log_axis)}


def _style(trace: Trace, number: int) -> dict[str, Any]:
    return {'label': trace.label, 'colour': trace.colour or COLOURS[number % len(COLOURS)],
            'dashed': trace.dashed, 'faint': trace.faint, 'marker': trace.marker}


def figure(name: str, plots: Sequence[dict[str, Any]] = ()) -> str:
    """Return the HTML of plots below each other; `name` must be the only one on its page."""
    content = (f'<script type="application/json">{script_json(list(plots))}</script>'
               if plots else '')
    thinned = max((each['thinned'] for each in plots), default=1)
    note = '' if thinned == 1 else (
        f'<p class=note>Drawn are the smallest and the largest of every {thinned} samples.</p>')
    return (f'<div class="figure" id="{escape(name)}"><noscript>Its curves need JavaScript.'
            f'</noscript>{content}</div>{note}')


def has_figures(body: str) -> bool:
    """Return whether HTML has figures in it."""
    return '<div class="figure"' in body


@cache
def drawing() -> str:
    """Return the elements that the head of a page with figures needs."""
    def read(name: str) -> str:
        return (ASSETS / name).read_text(encoding='utf-8').strip()

    return (f'<!-- uPlot: {read(LICENSE)} -->'
            + ''.join(f'<style>{read(name)}</style>' for name in STYLES)
            + ''.join(f'<script>{read(name)}</script>' for name in SCRIPTS))


def script_json(value: Any) -> str:
    """Return JSON that can stand in a script element."""
    text = json.dumps(value, separators=(',', ':'), allow_nan=False)
    return text.replace('</', '<\\/')
