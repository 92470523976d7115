"""Self-contained pages: one HTML file that needs neither network nor server."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from multicontact_control.experiment.claims import Claim, ClaimOverDamping
from multicontact_control.experiment.html_figure import drawing, has_figures
from multicontact_control.files import write_text

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1180px;
       margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.2em; margin-top: 2em; }
table { border-collapse: collapse; margin: .6em 0; font-size: 13px; }
th, td { border-bottom: 1px solid #ddd; padding: .25em .6em; text-align: left;
         vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
tr.choice { cursor: pointer; } tr.choice:hover { background: #eef3fa; }
tr.chosen { background: #dce8f7; }
.yes { color: #18794e; } .no { color: #c0262d; } .unknown { color: #777; }
.note { color: #555; font-size: 13px; }
pre { background: #f6f6f6; padding: .8em; overflow-x: auto; font-size: 12px; }
img { max-width: 100%; }
.figure { margin: .8em 0; } .figure .u-title { font-size: 14px; }
.figure .u-legend { font-size: 12px; font-variant-numeric: tabular-nums; }
.figure .u-legend th, .figure .u-legend td { border: 0; }
"""


def page(title: str, body: str) -> str:
    """Return a page of a plain title and a body in HTML, with what draws its figures."""
    drawn = drawing() if has_figures(body) else ''
    return (f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            f'<title>{escape(title)}</title><style>{STYLE}</style>'
            f'{drawn}</head>\n<body><h1>{escape(title)}</h1>\n{body}\n'
            '</body></html>\n')


def write_page(path: Path, title: str, body: str) -> None:
    """Write a page such that a reader sees the old file or the new one, never half of one."""
    write_text(path, page(title, body))


def table(
    head: Sequence[str], rows: Sequence[Sequence[str]], *, numbers_from: int = 1,
    row_attributes: Sequence[str] = (),
) -> str:
    """
    Return a table.

    Parameters
    ----------
    head, rows
        HTML of the cells; what is not HTML has to be escaped before.
    numbers_from
        First column that is set to the right.
    row_attributes
        Of each row's element.

    """
    def line(cells: Sequence[str], tag: str, attribute: str = '') -> str:
        inner = ''.join(
            f'<{tag}{" class=number" if i >= numbers_from else ""}>{cell}</{tag}>'
            for i, cell in enumerate(cells))
        return f'<tr {attribute}>{inner}</tr>'

    lines = [line(row, 'td', row_attributes[i] if i < len(row_attributes) else '')
             for i, row in enumerate(rows)]
    return f'<table>{line(head, "th")}{"".join(lines)}</table>'


VERDICTS = {True: '<b class=yes>holds</b>', False: '<b class=no>does not hold</b>',
            None: '<span class=unknown>not judged</span>'}


def claims_over_damping(claims: Sequence[ClaimOverDamping]) -> str:
    """Return the table of the paper's claims over K_2, which it leaves open."""
    rates = list(claims[0].verdicts) if claims else []
    rows = []
    for each in claims:
        first = next(iter(each.verdicts.values()))
        rows.append((
            escape(first.claim), escape(first.paper),
            *(f'{VERDICTS[claim.holds]}<br>{escape(claim.measured)}'
              for claim in each.verdicts.values()), '<b>yes</b>' if each.depends else 'no'))
    return table(('claim', 'in the paper', *(f'K<sub>2</sub> = {rate:g} 1/s' for rate in rates),
                  'depends on K<sub>2</sub>'), rows, numbers_from=9)


def claims_table(claims: Sequence[Claim]) -> str:
    """Return the table of the paper's claims."""
    return table(
        ('claim', 'in the paper', 'measured', 'verdict', 'why'),
        [(escape(claim.claim), escape(claim.paper), escape(claim.measured),
          VERDICTS[claim.holds], escape(claim.why)) for claim in claims], numbers_from=9)


def image(path: Path, alt: str) -> str:
    """Return a PNG file as part of the page."""
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{escape(alt)}" src="data:image/png;base64,{data}">'
