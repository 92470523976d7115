"""`multicontact report`: scenario, verdict, numbers and figures of runs, on one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
import os
from pathlib import Path
from typing import Any

from multicontact_control.errors import ConfigError
from multicontact_control.judging import page
from multicontact_control.judging.claims import judge_claims_of_run
from multicontact_control.judging.display import (
    describe_arm,
    describe_run,
    list_summary_rows,
    OTHER_COLOUR,
    VERDICT_COLOURS,
)
from multicontact_control.judging.figure_files import draw_figures, draw_side_by_side
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.pass_table import render_passes
from multicontact_control.judging.passes import write_passes
from multicontact_control.judging.results import LoadedRun
from multicontact_control.judging.run_figures import (
    describe_figures,
    list_shaded_spans,
)
from multicontact_control.judging.run_folders import FIGURE_FOLDER, REPORT_FILE
from multicontact_control.judging.verdict import describe_verdict
import yaml


def write_report(
    runs: Sequence[LoadedRun], out: Path, *, claims: bool = False
) -> list[Path]:
    """
    Write ``report.html``, ``figures/`` and the passes along paths of runs into a folder.

    The files with the passes of a single run stand beside the page, those of several beside the
    figures of each.

    Parameters
    ----------
    runs
        At least one.
    out
        The folder, which is made if it does not exist.
    claims
        Whether the paper's claims are judged by all runs, and not only by those of its scenario.

    Returns
    -------
    list of Path
        The page, and the figures behind it.

    Raises
    ------
    ConfigError
        If the folder cannot be made.

    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            'out', 'a folder that can be made', f'{out} ({error.strerror})'
        ) from None
    figures = out / FIGURE_FOLDER
    names = _name_runs(runs)
    metrics = [run.metrics for run in runs]
    paths = []
    parts = []
    title = describe_run(runs[0].summary)
    if len(runs) > 1:
        title = f'{len(runs)} runs: {", ".join(names)}'
        paths += draw_side_by_side(names, metrics, figures)
        parts.append(_compare_runs(names, runs))
        parts.append(page.render_image(paths[0], 'forces of the runs'))
    for number, run in enumerate(runs):
        folder = figures
        table_folder = out
        if len(runs) > 1:
            folder = table_folder = figures / names[number]
            heading = f'{escape(names[number])}: {escape(describe_run(run.summary))}'
            parts.append(f'<h2>{heading}</h2>')
        drawn = draw_figures(metrics[number], run.summary, folder)
        passes = write_passes(metrics[number], table_folder)
        path = render_passes(passes, drawn)
        parts += _render_run(run, metrics[number], f'run{number}', path, claims=claims)
        paths += drawn
    report = out / REPORT_FILE
    page.write_page(report, title, '\n'.join(parts))
    return [report, *paths]


def _name_runs(runs: Sequence[LoadedRun]) -> list[str]:
    """Return the paths of the runs from the folder that they have in common."""
    folders = [run.folder.resolve() for run in runs]
    parents = [folder.parent for folder in folders]
    common = os.path.commonpath(parents)
    return [folder.relative_to(common).as_posix() for folder in folders]


def _render_run(
    run: LoadedRun, metrics: RunMetrics, prefix: str, path: str, *, claims: bool
) -> list[str]:
    """
    Return the parts of the page that are about one run.

    `prefix` is that of its figures, `path` what is shown of its passes.
    """
    setup = run.setup
    summary = run.summary
    description = ''
    if not setup.commanded_by_topic:
        description = setup.scenario.description
    colour = VERDICT_COLOURS.get(summary['verdict'], OTHER_COLOUR)
    parts = [
        f'<p class=note>{escape(description)}</p>',
        f'<p class="verdict {colour}"><b>{escape(describe_verdict(summary))}</b></p>'
        f'<p class=note>Judged: {escape(summary["judged"])}.</p>',
        f'<p>{escape(summary.get("quality", ""))}</p>',
    ]
    for remark in summary.get('remarks', ()):
        parts.append(f'<p class=note>{escape(remark)}</p>')
    parts.append(_render_numbers(summary))
    parts.append(render_figures(metrics, prefix))
    parts.append(page.HELP)
    parts.append(path)
    judged = judge_claims_of_run(metrics, summary, any_scenario=claims)
    if judged:
        table = page.render_claims({'measured': judged})
        parts.append(f'<h3>Claims of the paper</h3>{table}')
    timing = {**summary['timing']}
    timing.pop('latency_histogram', None)
    parts.append(page.render_details('Timing', _render_yaml(timing)))
    parts.append(_render_configuration(run))
    return parts


def render_figures(run: RunMetrics, prefix: str) -> str:
    """
    Return the figures of a run, whose names on the page begin with a prefix.

    Names are unique on the page, since its script finds a chart by them. The result is HTML with
    the data of every trace.
    """
    shaded = list_shaded_spans(run)
    parts = []
    for figure in describe_figures(run):
        name = f'{prefix}-{figure.file}'
        parts.append(page.render_figure(name, figure, run.data.time, shaded))
    return '\n'.join(parts)


def _render_numbers(summary: Mapping[str, Any]) -> str:
    """Return the numbers of the contacts and of the arm, as far as they are known."""
    rows = [list(map(escape, row)) for row in list_summary_rows(summary)]
    table = ''
    if rows:
        table = page.render_table(('', *map(escape, summary['contacts'])), rows)
    return f'{table}<p>{describe_arm(summary)}</p>'


def _compare_runs(names: Sequence[str], runs: Sequence[LoadedRun]) -> str:
    """Return a table of the runs with a column for each: verdict, contacts and arm."""
    verdicts = ['verdict']
    arms = ['arm']
    columns = []
    labels: dict[str, dict[str, None]] = {}  # of each contact, of any run, in order
    for run in runs:
        verdicts.append(escape(run.summary['verdict']))
        arms.append(describe_arm(run.summary).replace(', ', '<br>'))
        numbers = _list_numbers(run.summary)
        columns.append(numbers)
        for contact, label in numbers:
            labels.setdefault(contact, {})[label] = None
    rows = [verdicts]
    for contact, labels_of_contact in labels.items():
        for label in labels_of_contact:
            cells = [f'{contact}: {label}']
            for numbers in columns:
                cells.append(numbers.get((contact, label), '-'))
            rows.append([*map(escape, cells)])
    rows.append(arms)
    return page.render_table(('', *map(escape, names)), rows)


def _list_numbers(summary: Mapping[str, Any]) -> dict[tuple[str, str], str]:
    """Return the numbers of a run by contact and label."""
    numbers = {}
    for label, *values in list_summary_rows(summary):
        for contact, value in zip(summary['contacts'], values):
            numbers[contact, label] = value
    return numbers


def _render_configuration(run: LoadedRun) -> str:
    setup = run.setup
    if not setup.controller.contacts:
        return '<p class=note>Not known: <code>--controller</code> takes the parameter file.</p>'
    sections = {'scenario': setup.scenario, 'controller': setup.controller}
    if setup.simulated:
        sections['noise_estimator'] = setup.noise_estimator
        sections['plant'] = setup.plant
    parts = []
    for name, section in sections.items():
        values = _render_yaml(section.model_dump(mode='json'))
        parts.append(page.render_details(name, values))
    return page.render_details('Configuration', ''.join(parts))


def _render_yaml(values: Mapping[str, Any]) -> str:
    return f'<pre>{escape(yaml.safe_dump(dict(values), sort_keys=False))}</pre>'
