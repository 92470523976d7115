"""`multicontact report`: the paper's figures, claims, configuration and timing of runs."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.claims import Claim, claims_of, judge_over_damping
from multicontact_control.experiment.display import headline
from multicontact_control.experiment.figures import (
    draw_figures,
    draw_side_by_side,
    interactive_figures,
)
from multicontact_control.experiment.judge import STABLE, verdict_text
from multicontact_control.experiment.page import (
    claims_over_damping,
    claims_table,
    HELP,
    image,
    table,
    write_page,
)
from multicontact_control.experiment.results import FIGURE_FOLDER, LoadedRun, REPORT_FILE
from multicontact_control.experiment.study.presets.compare.results import (
    claim_rows,
    comparison_claims,
    comparison_listing,
    findings,
)
from multicontact_control.experiment.study.table import html_table, short_names
import yaml

FORMATS = ('png', 'pdf')


def run_claims(run: LoadedRun, comparison: dict[str, Any] | None = None) -> list[Claim]:
    """Judge the paper's claims by a run, and those that compare by a ``comparison.json``."""
    return claims_of(run.data, run.setup, run.summary,
                     claim_rows(comparison['rows']) if comparison else ())


def write_report(
    runs: Sequence[LoadedRun], out: Path, comparison: dict[str, Any] | None = None,
) -> list[Path]:
    """
    Write ``report.html`` and ``figures/`` of at least one run into a folder and return the files.

    The page comes first; `comparison` is the content of ``comparison.json``. Raises ConfigError if
    the folder cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError('out', 'a folder that can be made',
                          f'{out} ({error.strerror})') from None
    paths, parts = [], [] if comparison is None else [_comparison_section(comparison)]
    names = short_names([run.folder.resolve().as_posix().strip('/') for run in runs], '/')
    for number, (name, run) in enumerate(zip(names, runs)):
        paths += draw_figures(
            run.data, run.setup, out / FIGURE_FOLDER / (name if len(runs) > 1 else ''),
            verdict=verdict_text(run.summary), formats=FORMATS)
        parts.append(_run_section(run, number, comparison))
    if len(runs) > 1:
        paths.append(draw_side_by_side(
            [(name, run.data, run.setup) for name, run in zip(names, runs)],
            out / FIGURE_FOLDER / 'side_by_side.png'))
        parts.insert(0, f'<h2>Side by side</h2>{image(paths[-1], "forces of the runs")}')
    page = out / REPORT_FILE
    write_page(page, 'Multi-contact force control: the paper put to the test', '\n'.join(parts))
    return [page, *paths]


def _run_section(run: LoadedRun, number: int, comparison: dict[str, Any] | None) -> str:
    summary, claims = run.summary, run_claims(run, comparison)
    colour = 'yes' if verdict_text(summary) == STABLE else 'no'
    verdict = f'<b class={colour}>{escape(verdict_text(summary))}</b>'
    parts = [
        f'<h2>{escape(headline(summary))}</h2><p>{verdict}. '
        f'Torques sha256 {escape(summary["trajectory_sha256"][:16])}.</p>',
        *(f'<p class=note>{escape(text)}</p>' for text in summary.get('remarks', ())),
        '<h3>Claims of the paper</h3>', claims_table(claims) if claims else '<p class=note>Not '
        'judged: they are about a simulated plant that plays its scenario.</p>',
        '<h3>Figures 3 to 6 of the paper</h3>', HELP,
        interactive_figures(run.data, run.setup, number),
        '<h3>Numbers</h3>', _numbers(summary), '<h3>Timing</h3>', _timing(summary),
        '<h3>Configuration</h3>', _configuration(run)]
    return '\n'.join(parts)


def _numbers(summary: dict[str, Any]) -> str:
    contacts = summary['contacts']
    if not contacts:
        return '<p class=note>The recording names no contacts.</p>'
    rows = [['step rise 63 % [s]', *(_text(c['step_rise_63_s']) for c in contacts.values())],
            ['overshoot [%]', *(_text(c['step_overshoot_percent']) for c in contacts.values())]]
    for window in ('rest', 'moving'):
        for name in next(iter(contacts.values()))[window]:
            rows.append([f'{window}: {escape(name)}',
                         *(_text(c[window][name]) for c in contacts.values())])
    return table(('', *map(escape, contacts)), rows)


def _timing(summary: dict[str, Any]) -> str:
    rows = []
    for name, values in summary['timing'].items():
        text = ', '.join(f'{key} {_text(value)}' for key, value in values.items()) if (
            isinstance(values, dict)) else _text(values)
        rows.append([escape(name), escape(text)])
    return table(('', ''), rows, numbers_from=9)


def _configuration(run: LoadedRun) -> str:
    if not run.setup.controller.contacts:
        return '<p class=note>Not known: <code>--controller</code> takes the parameter file.</p>'
    parts = []
    names = ('scenario', 'controller', 'noise_estimator', 'plant')
    for name in names if run.setup.simulated else names[:2]:
        text = yaml.safe_dump(getattr(run.setup, name).model_dump(mode='json'), sort_keys=False)
        parts.append(f'<details><summary>{name}</summary><pre>{escape(text)}</pre></details>')
    return '\n'.join(parts)


def _comparison_section(comparison: dict[str, Any]) -> str:
    rows = comparison['rows']
    parts = ['<h2>Measured by the comparison</h2><ul>',
             *(f'<li>{escape(text)}</li>' for text in findings(rows)), '</ul>']
    for plant in dict.fromkeys(row['plant'] for row in rows):
        parts += [f'<h3>Claims over K<sub>2</sub>, plant {escape(plant)}</h3>',
                  claims_over_damping(judge_over_damping(comparison_claims(rows)[plant])),
                  f'<h3>Plant {escape(plant)}: worse contact, median over the seeds</h3>',
                  html_table(comparison_listing(rows, plant))]
    return '\n'.join(parts)


def _text(value: Any) -> str:
    return f'{value:.4g}' if isinstance(value, float) else '-' if value is None else str(value)
