"""The page of a study: what came out, the figure, and a section for each of its tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from matplotlib.figure import Figure
from multicontact_control.experiment.page import image, write_page
from multicontact_control.experiment.study.table import html_table, Listing

DPI = 130  # of the figure


@dataclass(frozen=True)
class Section:
    """A part of a page: a table, with HTML on either side, that the terminal may show, too."""

    heading: str  # plain text; the title of the table in the terminal
    listing: Listing | None = None
    in_terminal: bool = True
    before: str = ''
    after: str = ''

    def html(self) -> str:
        """Return it as HTML."""
        shown = html_table(self.listing) if self.listing is not None else ''
        return f'<h2>{escape(self.heading)}</h2>{self.before}{shown}{self.after}'


@dataclass(frozen=True)
class Page:
    """What is shown of a study; titles, paragraphs and sentences are plain text."""

    title: str
    sections: Sequence[Section]
    introduction: Sequence[str] = ()  # paragraphs
    warnings: Sequence[str] = ()  # what is not as it should be
    findings: Sequence[str] = ()  # what came out
    figure: Figure | None = None  # before the sections, and in a PNG file of its own
    script: str = ''  # JavaScript that runs when all is there


def write_study_page(page: Page, path: Path) -> list[Path]:
    """Write a page, which stands alone, and its figure, to a path without suffix."""
    paths = []
    body = [f'<p>{escape(text)}</p>' for text in page.introduction if text]
    items = [f'<li class=no>{escape(text)}</li>' for text in page.warnings]
    items += [f'<li>{escape(text)}</li>' for text in page.findings]
    if items:
        body.append(f'<h2>What came out</h2><ul>{"".join(items)}</ul>')
    if page.figure is not None:
        png = path.with_suffix('.png')
        page.figure.savefig(png, dpi=DPI)
        body.append(image(png, page.title))
        paths.append(png)
    body += [section.html() for section in page.sections]
    if page.script:
        body.append(f'<script>{page.script}</script>')
    write_page(path.with_suffix('.html'), page.title, '\n'.join(body))
    return [*paths, path.with_suffix('.html')]
