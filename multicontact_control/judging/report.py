"""`multicontact report`: scenario, verdict, numbers and figures of runs, on one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
import os
from pathlib import Path
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.judging import figures, page
from multicontact_control.judging.claims import Claim, claims_of
from multicontact_control.judging.display import (
    arm_line,
    COLOURS,
    headline,
    summary_rows,
)
from multicontact_control.judging.figures import FORMATS
from multicontact_control.judging.results import (
    FIGURE_FOLDER,
    LoadedRun,
    REPORT_FILE,
)
from multicontact_control.judging.verdict import verdict_text
import yaml


def write_report(
    runs: Sequence[LoadedRun], out: Path, *, claims: bool = False
) -> list[Path]:
    """
    Write ``report.html`` and ``figures/`` of at least one run into a folder and return the files.

    The page comes first. The paper's claims are judged by runs of its scenario, with `claims` by
    all. Raises ConfigError if the folder cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            'out', 'a folder that can be made', f'{out} ({error.strerror})'
        ) from None
    paths, parts = [], []
    folders = [run.folder.resolve() for run in runs]
    common = os.path.commonpath([folder.parent for folder in folders])
    names = [folder.relative_to(common).as_posix() for folder in folders]
    for number, (name, run) in enumerate(zip(names, runs)):
        paths += figures.draw_figures(
            run.data,
            run.setup,
            run.summary,
            out / FIGURE_FOLDER / (name if len(runs) > 1 else ''),
            FORMATS,
        )
        if len(runs) > 1:
            parts.append(f'<h2>{escape(name)}: {escape(headline(run.summary))}</h2>')
        parts += _run_section(
            run, number, claims_of(run.data, run.setup, run.summary, asked=claims)
        )
    if len(runs) > 1:
        drawn = figures.draw_side_by_side(
            [(name, run.data, run.setup) for name, run in zip(names, runs)],
            out / FIGURE_FOLDER,
            FORMATS,
        )
        paths += drawn
        parts[:0] = [
            _comparison(names, [run.summary for run in runs]),
            page.image(drawn[0], 'forces of the runs'),
        ]
    report = out / REPORT_FILE
    page.write_page(
        report,
        headline(runs[0].summary)
        if len(runs) == 1
        else f'{len(runs)} runs: {", ".join(names)}',
        '\n'.join(parts),
    )
    return [report, *paths]


def _run_section(run: LoadedRun, number: int, claims: Sequence[Claim]) -> list[str]:
    setup, summary = run.setup, run.summary
    about = '' if setup.commanded_by_topic else setup.scenario.description
    return [
        f'<p class=note>{escape(about)}</p>',
        f'<p class="verdict {COLOURS.get(summary["verdict"], "yellow")}">'
        f'<b>{escape(verdict_text(summary))}</b></p>'
        f'<p class=note>Judged: {escape(summary["judged"])}.</p>',
        f'<p>{escape(summary.get("quality", ""))}</p>',
        *(f'<p class=note>{escape(text)}</p>' for text in summary.get('remarks', ())),
        _numbers(summary),
        figures.interactive_figures(run.data, setup, number),
        page.HELP,
        '<h3>Claims of the paper</h3>' + page.claims_table({'measured': claims})
        if claims
        else '',
        page.folded(
            'Timing',
            _yaml(
                {
                    name: value
                    for name, value in summary['timing'].items()
                    if name != 'latency_histogram'
                }
            ),
        ),
        _configuration(run),
    ]


def _numbers(summary: Mapping[str, Any]) -> str:
    """Return the numbers of the contacts and of the arm, as far as they are known."""
    rows = [list(map(escape, row)) for row in summary_rows(summary)]
    table = page.table(('', *map(escape, summary['contacts'])), rows) if rows else ''
    return f'{table}<p>{arm_line(summary)}</p>'


def _comparison(names: Sequence[str], summaries: Sequence[Mapping[str, Any]]) -> str:
    """Return a table of the runs with a column for each: verdict, contacts and arm."""
    tables = [_numbers_by_contact(summary) for summary in summaries]
    labels = dict.fromkeys(label for numbers in tables for label in numbers)
    contacts = list(dict.fromkeys(contact for contact, _ in labels))
    rows = [['verdict', *(escape(summary['verdict']) for summary in summaries)]]
    for contact, label in sorted(labels, key=lambda each: contacts.index(each[0])):
        rows.append(
            [
                escape(f'{contact}: {label}'),
                *(escape(numbers.get((contact, label), '-')) for numbers in tables),
            ]
        )
    rows.append(
        ['arm', *(arm_line(summary).replace(', ', '<br>') for summary in summaries)]
    )
    return page.table(('', *map(escape, names)), rows)


def _numbers_by_contact(summary: Mapping[str, Any]) -> dict[tuple[str, str], str]:
    """Return the numbers of a run by contact and label."""
    return {
        (contact, label): value
        for label, *values in summary_rows(summary)
        for contact, value in zip(summary['contacts'], values)
    }


def _configuration(run: LoadedRun) -> str:
    if not run.setup.controller.contacts:
        return '<p class=note>Not known: <code>--controller</code> takes the parameter file.</p>'
    names = ('scenario', 'controller', 'noise_estimator', 'plant')
    return page.folded(
        'Configuration',
        ''.join(
            page.folded(name, _yaml(getattr(run.setup, name).model_dump(mode='json')))
            for name in (names if run.setup.simulated else names[:2])
        ),
    )


def _yaml(values: Mapping[str, Any]) -> str:
    return f'<pre>{escape(yaml.safe_dump(dict(values), sort_keys=False))}</pre>'
