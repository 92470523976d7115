"""Self-contained pages: tables and figures in one HTML file, without network or server."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
import json
from pathlib import Path
from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.errors import format_count
from multicontact_control.files import replace_text_file
from multicontact_control.judging.claims import Claim
from multicontact_control.judging.panels import (
    Panel,
    RunFigure,
    ShadedSpan,
    WINDOW_COLOURS,
)
import numpy as np
import pandas as pd

ASSETS = Path(__file__).parent / 'page_assets'
MOST_SAMPLES = 2000  # of a curve
FIGURE_START = '<div class="figure"'
HELP = (
    '<p class=note>Drag over a figure to zoom into all of them, double click to see all '
    'again; click a name to hide its curve. Of a long run the smallest and the largest of '
    'every few samples are drawn.</p>'
)
CLAIM_VERDICTS = {
    True: '<b class=green>as in the paper</b>',
    False: '<b class=yellow>differs</b>',
    None: '<span class=note>not judged</span>',
}


def thin_series(
    time: Vector, series: Sequence[Vector], most_samples: int = MOST_SAMPLES
) -> tuple[Vector, Matrix]:
    """
    Thin a run out for drawing and keep every peak.

    Parameters
    ----------
    time
        Times of the samples, shape (m,) [s].
    series
        k series, each of shape (m,).
    most_samples
        What is left is about this many samples: the smallest and largest of every few.

    Returns
    -------
    time, series
        Shapes (j,) and (k, j); what is not finite is NaN.

    """
    values = np.where(np.isfinite(series), series, np.nan)
    size = -(-2 * len(time) // most_samples)
    if size <= 2:
        return time, values
    groups = pd.DataFrame(values.T).groupby(np.arange(len(time)) // size)
    extremes = np.stack([groups.min(), groups.max()], axis=1)
    return np.repeat(time[::size], 2), extremes.reshape(-1, len(series)).T


def render_figure(
    name: str, figure: RunFigure, time: Vector, shaded: Sequence[ShadedSpan] = ()
) -> str:
    """
    Return a figure in HTML, drawn by the script of the page.

    Parameters
    ----------
    name
        The only one of its kind on the page.
    figure
        Panels whose traces have shape (m,).
    time
        Times of the samples, shape (m,) [s].
    shaded
        Stretches that are shaded behind the curves.

    """
    plots = []
    heading = figure.title
    for panel in figure.panels:
        plots.append({'heading': heading, **_describe_plot(panel, time, shaded)})
        heading = ''
    text = json.dumps(plots, separators=(',', ':'), allow_nan=False)
    text = text.replace('</', '<\\/')
    return (
        f'{FIGURE_START} id="{escape(name)}"><noscript>Its curves need JavaScript.'
        f'</noscript><script type="application/json">{text}</script></div>'
    )


def _describe_plot(
    panel: Panel, time: Vector, shaded: Sequence[ShadedSpan]
) -> dict[str, Any]:
    """Return a panel as the script of the page takes it."""
    times, series = thin_series(time, [trace.values for trace in panel.traces])
    smallest = -np.inf
    if panel.logarithmic:
        smallest = 0.0
    columns = [np.round(times, 4).tolist()]
    for values in series:
        columns.append([_round_number(value, smallest) for value in values])
    curves = []
    for trace in panel.traces:
        curve = trace._asdict()
        del curve['values']
        curves.append(curve)
    return {
        'label': panel.label,
        'shades': WINDOW_COLOURS,
        'logarithmic': panel.logarithmic,
        'least': panel.least_span,
        'shaded': shaded,
        'curves': curves,
        'data': columns,
    }


def _round_number(value: float, smallest: float) -> float | None:
    """Return a value with five digits, None if it is NaN or not above the smallest."""
    if value > smallest:
        return float(f'{value:.5g}')
    return None


def write_page(path: Path, title: str, body: str) -> None:
    """
    Write a page with a title and a body of HTML, which needs no other file and no network.

    Style and script are those of the package, written into it; charts are drawn by the script from
    data on the page.
    """
    drawing = ''
    if FIGURE_START in body:
        # The license goes with every copy.
        drawing = (
            f'<!-- uPlot: {_read_asset("uPlot.LICENSE")} -->'
            f'<style>{_read_asset("uPlot.min.css")}</style>'
            f'<script>{_read_asset("uPlot.iife.min.js")}</script>'
            f'<script>{_read_asset("figures.js")}</script>'
        )
    replace_text_file(
        path,
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<title>{escape(title)}</title><style>{_read_asset("page.css")}</style>'
        f'{drawing}</head>\n<body><h1>{escape(title)}</h1>\n{body}\n</body></html>\n',
    )


def _read_asset(name: str) -> str:
    return (ASSETS / name).read_text(encoding='utf-8').strip()


def render_table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    numbers_from: int = 1,
) -> str:
    """Return a table of HTML cells, with the columns from `numbers_from` on set to the right."""
    lines = [_render_row(head, 'th', numbers_from)]
    for row in rows:
        lines.append(_render_row(row, 'td', numbers_from))
    return f'<table>{"".join(lines)}</table>'


def _render_row(cells: Sequence[str], tag: str, numbers_from: int) -> str:
    texts = [f'<{tag}>{cell}</{tag}>' for cell in cells[:numbers_from]]
    for cell in cells[numbers_from:]:
        texts.append(f'<{tag} class=number>{cell}</{tag}>')
    return f'<tr>{"".join(texts)}</tr>'


def render_details(title: str, content: str) -> str:
    """Return a part of a page in HTML that opens at a click on its plain title."""
    return f'<details><summary>{escape(title)}</summary>{content}</details>'


def render_claims(claims: Mapping[str, Sequence[Claim]]) -> str:
    """
    Return a table of the paper's claims with a column for each run, by the runs' plain names.

    Claims that no run can tell of stand in a table of their own, which opens at a click.
    """
    judged = []
    others = []
    for of_runs in zip(*claims.values()):
        claim = of_runs[0]
        said = (escape(claim.claim), escape(claim.paper))
        expected = escape(claim.why)
        verdicts = {each.holds for each in of_runs}
        if verdicts == {None}:
            others.append((*said, expected))
        else:
            judged.append((*said, *map(_render_measured, of_runs), expected))
    head = ('claim', 'in the paper', *map(escape, claims), 'expected')
    page = render_table(head, judged, numbers_from=len(head))
    if others:
        title = (
            f'{format_count(len(others), "claims")} not judged: `multicontact study compare` '
            'has the runs that they are about'
        )
        table = render_table(
            ('claim', 'in the paper', 'expected'), others, numbers_from=3
        )
        page += render_details(title, table)
    return page


def _render_measured(claim: Claim) -> str:
    return f'{CLAIM_VERDICTS[claim.holds]}<br>{escape(claim.measured)}'


def render_image(path: Path, alternative: str) -> str:
    """Return a PNG file as a part of the page; `alternative` is its text for screen readers."""
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{escape(alternative)}" src="data:image/png;base64,{data}">'
