"""`multicontact report`: verdict, figures, the paper's claims and the numbers of runs."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
import os
from pathlib import Path
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.claims import claims_of, Runs
from multicontact_control.experiment.display import achievement, headline, summary_rows
from multicontact_control.experiment.figures import (
    draw_figures,
    draw_side_by_side,
    interactive_figures,
)
from multicontact_control.experiment.judge import STABLE, verdict_text
from multicontact_control.experiment.page import claims_table, HELP, image, table, write_page
from multicontact_control.experiment.results import FIGURE_FOLDER, LoadedRun, REPORT_FILE
import yaml

FORMATS = ('png', 'pdf')


def write_report(
    runs: Sequence[LoadedRun], out: Path, comparison: Runs = (),
) -> list[Path]:
    """
    Write ``report.html`` and ``figures/`` of at least one run into a folder and return the files.

    The page comes first; `comparison` are the runs of a study for the claims that compare. Raises
    ConfigError if the folder cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError('out', 'a folder that can be made',
                          f'{out} ({error.strerror})') from None
    paths, parts = [], []
    folders = [run.folder.resolve() for run in runs]
    common = os.path.commonpath([folder.parent for folder in folders])
    names = [folder.relative_to(common).as_posix() for folder in folders]
    for number, (name, run) in enumerate(zip(names, runs)):
        paths += draw_figures(
            run.data, run.setup, out / FIGURE_FOLDER / (name if len(runs) > 1 else ''),
            verdict=verdict_text(run.summary), formats=FORMATS)
        if len(runs) > 1:
            parts.append(f'<h2>{escape(name)}: {escape(headline(run.summary))}</h2>')
        parts += _run_section(run, number, comparison)
    if len(runs) > 1:
        paths.append(draw_side_by_side(
            [(name, run.data, run.setup) for name, run in zip(names, runs)],
            out / FIGURE_FOLDER / 'side_by_side.png'))
        parts.insert(0, image(paths[-1], 'forces of the runs'))
    page = out / REPORT_FILE
    write_page(page, headline(runs[0].summary) if len(runs) == 1 else
               f'{len(runs)} runs: {", ".join(names)}', '\n'.join(parts))
    return [page, *paths]


def _run_section(run: LoadedRun, number: int, comparison: Runs) -> list[str]:
    summary, verdict = run.summary, verdict_text(run.summary)
    claims = claims_of(run.data, run.setup, summary, comparison)
    return [
        f'<p class=verdict><b class={"yes" if verdict == STABLE else "no"}>{escape(verdict)}</b>. '
        f'{escape(achievement(summary))}.</p>',
        *(f'<p class=note>{escape(text)}</p>' for text in summary.get('remarks', ())),
        interactive_figures(run.data, run.setup, number), HELP,
        '<h3>Numbers</h3>', table(('', *map(escape, summary['contacts'])), [
            list(map(escape, row)) for row in summary_rows(summary)]),
        '<h3>Claims of the paper</h3>' + claims_table({'measured': claims}) if claims else '',
        '<h3>Timing</h3>', table(('', ''), [
            [escape(name), escape(_text(value))] for name, value in summary['timing'].items()
            if name != 'latency_histogram'], numbers_from=9),
        '<h3>Configuration</h3>', _configuration(run),
        f'<p class=note>Torques sha256 {summary["trajectory_sha256"][:16]}</p>']


def _configuration(run: LoadedRun) -> str:
    if not run.setup.controller.contacts:
        return '<p class=note>Not known: <code>--controller</code> takes the parameter file.</p>'
    parts = []
    names = ('scenario', 'controller', 'noise_estimator', 'plant')
    for name in names if run.setup.simulated else names[:2]:
        text = yaml.safe_dump(getattr(run.setup, name).model_dump(mode='json'), sort_keys=False)
        parts.append(f'<details><summary>{name}</summary><pre>{escape(text)}</pre></details>')
    return '\n'.join(parts)


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ', '.join(f'{key} {_text(each)}' for key, each in value.items())
    return f'{value:.4g}' if isinstance(value, float) else '-' if value is None else str(value)
