"""Self-contained pages: tables and figures in one HTML file, without network or server."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
import json
from pathlib import Path
from typing import Any, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.errors import format_count
from multicontact_control.files import replace_text_file
from multicontact_control.judging.claims import Claim
import numpy as np
import pandas as pd

ASSETS = Path(__file__).parent / 'page_assets'
LONGEST = 2000  # samples of a curve
HELP = (
    '<p class=note>Drag over a figure to zoom into all of them, double click to see all '
    'again; click a name to hide its curve. Of a long run the smallest and the largest of '
    'every few samples are drawn.</p>'
)
# Colours of Okabe and Ito, which differ for colour-blind readers, too.
COLOURS = ('#0072b2', '#e69f00', '#009e73', '#d55e00', '#cc79a7', '#56b4e9', '#777777')
MEASURED, TRUE, ESTIMATED, COMMANDED = '#56b4e9', '#d55e00', '#0072b2', '#222222'
WINDOWS = {'rest': '#eef1f4', 'start': '#f9e2d6', 'moving': '#faf3e0'}
VERDICTS = {
    True: '<b class=green>as in the paper</b>',
    False: '<b class=yellow>differs</b>',
    None: '<span class=note>not judged</span>',
}
Span = tuple[
    str, float, float
]  # name, start and end [s] of a stretch of a run that is shaded


class Trace(NamedTuple):
    """A series as a line."""

    label: str
    values: Vector  # shape (m,)
    colour: str = MEASURED
    dashed: bool = False
    faint: bool = False
    broad: bool = False  # a band, below what lies upon it


class Panel(NamedTuple):
    """Lines over time on common axes."""

    label: str  # of the vertical axis
    traces: Sequence[Trace]
    logarithmic: bool = False
    least: float = 0.0  # that the vertical axis spans, so that small noise looks small


def envelope(
    time: Vector, series: Sequence[Vector], longest: int = LONGEST
) -> tuple[Vector, Matrix]:
    """Thin times and series, each of shape (m,), out to `longest` samples and keep every peak."""
    values = np.where(np.isfinite(series), series, np.nan)
    size = -(-2 * len(time) // longest)
    if size <= 2:
        return time, values
    stretches = pd.DataFrame(values.T).groupby(np.arange(len(time)) // size)
    thinned = np.stack([stretches.min(), stretches.max()], axis=1)
    return np.repeat(time[::size], 2), thinned.reshape(-1, len(series)).T


def figure(
    name: str,
    title: str,
    panels: Sequence[Panel],
    time: Vector,
    shaded: Sequence[Span] = (),
) -> str:
    """Return the HTML of panels over time [s]; `name` must be the only one on its page."""
    plots: list[dict[str, Any]] = []
    for panel in panels:
        times, series = envelope(time, [trace.values for trace in panel.traces])
        least = 0.0 if panel.logarithmic else -np.inf
        plots.append(
            {
                'heading': '' if plots else title,
                'label': panel.label,
                'shades': WINDOWS,
                'logarithmic': panel.logarithmic,
                'least': panel.least,
                'shaded': shaded,
                'curves': [
                    {
                        'label': trace.label,
                        'colour': trace.colour,
                        'dashed': trace.dashed,
                        'faint': trace.faint,
                        'broad': trace.broad,
                    }
                    for trace in panel.traces
                ],
                'data': [
                    np.round(times, 4).tolist(),
                    *(
                        [float(f'{x:.5g}') if x > least else None for x in values]
                        for values in series
                    ),
                ],
            }
        )
    text = json.dumps(plots, separators=(',', ':'), allow_nan=False).replace(
        '</', '<\\/'
    )
    return (
        f'<div class="figure" id="{escape(name)}"><noscript>Its curves need JavaScript.'
        f'</noscript><script type="application/json">{text}</script></div>'
    )


def write_page(path: Path, title: str, body: str) -> None:
    """Write a page of a plain title and a body in HTML, with what draws its figures."""

    def read(name: str) -> str:
        return (ASSETS / name).read_text(encoding='utf-8').strip()

    # The license goes with every copy.
    drawing = (
        ''
        if '<div class="figure"' not in body
        else (
            f'<!-- uPlot: {read("uPlot.LICENSE")} --><style>{read("uPlot.min.css")}</style>'
            f'<script>{read("uPlot.iife.min.js")}</script><script>{read("figures.js")}</script>'
        )
    )
    replace_text_file(
        path,
        (
            f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            f'<title>{escape(title)}</title><style>{read("page.css")}</style>{drawing}</head>\n'
            f'<body><h1>{escape(title)}</h1>\n{body}\n</body></html>\n'
        ),
    )


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    numbers_from: int = 1,
) -> str:
    """Return a table of HTML cells, with the columns from `numbers_from` on set to the right."""

    def line(cells: Sequence[str], tag: str) -> str:
        return (
            '<tr>'
            + ''.join(
                f'<{tag}{" class=number" if i >= numbers_from else ""}>{cell}</{tag}>'
                for i, cell in enumerate(cells)
            )
            + '</tr>'
        )

    return (
        f'<table>{line(head, "th")}{"".join(line(row, "td") for row in rows)}</table>'
    )


def folded(title: str, content: str) -> str:
    """Return a part of a page in HTML that opens at a click on its plain title."""
    return f'<details><summary>{escape(title)}</summary>{content}</details>'


def claims_table(claims: Mapping[str, Sequence[Claim]]) -> str:
    """Return the paper's claims, with a column for each run by its name; folded if not judged."""
    rows = list(zip(*claims.values()))
    judged = [each for each in rows if any(claim.holds is not None for claim in each)]
    others = [
        (escape(each[0].claim), escape(each[0].paper), escape(each[0].why))
        for each in rows
        if each not in judged
    ]
    head = ('claim', 'in the paper', *map(escape, claims), 'expected')
    page = table(
        head,
        [
            (
                escape(each[0].claim),
                escape(each[0].paper),
                *(
                    f'{VERDICTS[claim.holds]}<br>{escape(claim.measured)}'
                    for claim in each
                ),
                escape(each[0].why),
            )
            for each in judged
        ],
        numbers_from=len(head),
    )
    if others:
        page += folded(
            f'{format_count(len(others), "claims")} not judged: `multicontact study compare` has '
            'the runs that they are about',
            table(('claim', 'in the paper', 'expected'), others, numbers_from=3),
        )
    return page


def image(path: Path, alt: str) -> str:
    """Return a PNG file as part of the page."""
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{escape(alt)}" src="data:image/png;base64,{data}">'
