"""How every study runs: cells, jobs, one table, one page; what presets have beside is theirs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import import_module
import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from multicontact_control import __version__
from multicontact_control.config import read_yaml, validate
from multicontact_control.errors import ConfigError, counted, RunError
from multicontact_control.experiment.judge import HELD
from multicontact_control.experiment.page import image, write_page
from multicontact_control.experiment.study.cells import Cell, run_cells, units_of
from multicontact_control.experiment.study.config import StudyConfig
from multicontact_control.experiment.study.execute import (
    dask_client,
    prepare_folder,
    read_cell,
    run_jobs,
    workers_at_once,
)
from multicontact_control.experiment.study.figure import draw_study
from multicontact_control.experiment.study.measure import metrics_row
from multicontact_control.experiment.study.table import (
    html_table,
    Listing,
    listing_of,
    table_columns,
    terminal_tables,
    worst,
)
from multicontact_control.experiment.terminal import terminal
from multicontact_control.files import replacing, write_json
import pandas as pd
from rich.console import Console
from rich.markup import escape as plain

DPI = 130  # of the figure
SHOWN = 60  # lines of a table that still fit a terminal
MOST_WARNINGS = 20
STUDY_FILE, TABLE_FILE, CSV_FILE = 'study.json', 'study.parquet', 'study.csv'
PAGE_FILE, FIGURE_FILE = 'study.html', 'study.png'
FILES = (STUDY_FILE, TABLE_FILE, CSV_FILE, PAGE_FILE, FIGURE_FILE)
Metrics = Mapping[str, Any]
Section = tuple[str, str]  # heading in plain text, and what stands below it in HTML


@dataclass(frozen=True)
class Results:
    """What came out of a study: what was measured in each cell, and the table of them."""

    metrics: Sequence[Metrics]
    frame: pd.DataFrame  # a row for each cell; `attrs` has factors and units
    folder: Path


class Study:
    """A study of a file; a kind with code of its own is a subclass in `presets`."""

    def __init__(self, config: StudyConfig) -> None:
        self.config = config

    def cells(self) -> list[Cell]:
        """Return every cell; ConfigError if one is not acceptable."""
        return run_cells(self.config)

    def further(self, results: Results) -> list[Cell]:
        """Return the cells that follow from the results of the first."""
        return []

    def rows(self, metrics: Metrics) -> list[dict[str, Any]]:
        """Return the rows of the table that the metrics of a cell make."""
        return [metrics_row(metrics)]

    def complete(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the table with further columns."""
        return frame

    def listing(self, results: Results) -> Listing:
        """Return what is shown of the table."""
        return listing_of(results.frame, self.config)

    def findings(self, results: Results) -> list[str]:
        """Return what came out, in sentences."""
        frame = results.frame
        ended, held = int(frame['error'].notna().sum()), int((frame['verdict'] == HELD).sum())
        return [f'{int(frame[self.config.truth].sum())} of {counted(len(frame), "runs")} are '
                f'{self.config.truth}'
                + (f'; {ended} ended early' if ended else '')
                + (f'; {held} are held by the supervisor' if held else '') + '.']

    def warnings(self, results: Results) -> list[str]:
        """Return which runs ended early and why, and which columns are not in the table."""
        frame = results.frame
        return [f'{self._name(row)}: {row["error"]}'
                for _, row in frame[frame['error'].notna()].iterrows()] + [
            f'columns: the table has nothing under {column.value}'
            for column in table_columns(frame, self.config) if column.value not in frame
            and worst(frame, column.value).isna().all()]

    def _name(self, row: Mapping[str, Any]) -> str:
        return ', '.join(f'{name} {row[name]}' for name in self._factors() if row[name] != '')

    def _factors(self) -> list[str]:
        varied = dict.fromkeys(
            name for part in self.config.parts.values() for name in part.factors)
        return [*(['part'] if len(self.config.parts) > 1 else []), 'plant', *varied, 'seed']

    def figure(self, results: Results) -> Figure | None:
        """Return the figure, None if there is none."""
        return draw_study(results.frame, self.config)

    def sections(self, results: Results) -> list[Section]:
        """Return what stands below the table on the page."""
        return []

    def write_further(self, results: Results) -> None:
        """Write files of the kind's own into the folder."""

    def succeeded(self, results: Results) -> bool:
        """Return whether the command ends with 0; most studies only measure."""
        return True

    def results(
        self, cells: Sequence[Cell], found: Mapping[str, Metrics], folder: Path,
    ) -> Results:
        """Return cells with what was measured in them, by key, as a table."""
        metrics = [found[cell.key] for cell in cells]
        frame = pd.DataFrame([
            {**cell.factors, **row, 'key': cell.key}
            for cell, measured in zip(cells, metrics) for row in self.rows(measured)])
        frame.attrs = {
            'factors': [name for name in cells[0].factors if name in frame],
            'units': units_of(cells), 'study': self.config.name, 'version': __version__}
        return Results(metrics, self.complete(frame), folder)


KINDS = {  # modules with a class of the kind, capitalised
    'compare': 'compare', 'laws': 'laws', 'map': 'robustness', 'robots': 'robots',
    'tune': 'tune', 'faults': 'faults'}


def study_of(config: StudyConfig) -> Study:
    """Return the study of a configuration, with the code that its kind has of its own."""
    if config.kind not in KINDS:
        return Study(config)
    module = import_module(f'{__package__}.presets.{KINDS[config.kind]}')
    study: Study = getattr(module, f'{config.kind.capitalize()}Study')(config)
    return study


@dataclass(frozen=True)
class StudyOptions:
    """How a study is run."""

    out: Path | None = None  # folder of the results; None for runs/<name>
    jobs: int = 0  # at once on this machine, 0 for every core
    dask: str = ''  # address of a Dask scheduler to use instead
    dry_run: bool = False  # only say what would be run
    overwrite: bool = False  # run finished jobs again

    def check(self) -> None:
        """Check what can be checked without doing anything; ConfigError if it is bad."""
        if self.jobs < 0:
            raise ConfigError('jobs', 'a whole number >= 0', self.jobs)
        if self.dask and self.jobs:
            raise ConfigError('jobs', 'nothing together with --dask, whose workers decide',
                              self.jobs)


def run_study(
    study: Study, options: StudyOptions, console: Console | None = None,
) -> Results | None:
    """
    Run a study, write its files, and show and return what came out; None of a dry run.

    Raises
    ------
    ConfigError
        If study or options are not acceptable, before anything is run.
    RunError
        If a worker dies; what is finished is kept.

    """
    console = console or terminal()
    options.check()
    cells = study.cells()
    folder = options.out or Path('runs') / study.config.name
    with dask_client(options.dask) as client:
        if not options.dry_run:
            prepare_folder(folder, overwrite=options.overwrite, results=FILES)
        keys = {cell.key for cell in cells}
        finished = 0 if options.overwrite else sum(
            read_cell(folder, key) is not None for key in keys)
        console.print(
            f'study {study.config.name}: {counted(len(keys), "jobs")}, {finished} of them '
            f'finished before; {workers_at_once(options.jobs, client)} at once', highlight=False)
        if options.dry_run:
            _show_grid(cells, console)
            return None

        def run(some: Sequence[Cell]) -> dict[str, dict[str, Any]]:
            return run_jobs({cell.key: cell.job for cell in some}, folder, workers=options.jobs,
                            client=client, console=console, title=study.config.name)

        found = run(cells)
        results = study.results(cells, found, folder)
        if further := study.further(results):
            found |= run(further)
            results = study.results([*cells, *further], found, folder)
    _write(study, results, console)
    return results


def _show_grid(cells: Sequence[Cell], console: Console) -> None:
    """Show every factor with its values."""
    for name in cells[0].factors:
        values = dict.fromkeys(str(cell.factors[name]) for cell in cells)
        if any(values):
            console.print(f'  {name}: {", ".join(filter(None, values))}', highlight=False,
                          markup=False, soft_wrap=True)


def _write(study: Study, results: Results, console: Console) -> None:
    """Write the files of a study and show what came out."""
    folder, listing = results.folder, study.listing(results)
    write_json(folder / STUDY_FILE, study.config.model_dump(mode='json'))
    for name, write in (
            (CSV_FILE, lambda path: results.frame.to_csv(path, index=False)),
            (TABLE_FILE, lambda path: results.frame.to_parquet(
                path, index=False, compression='zstd'))):
        with replacing(folder / name) as partial:
            write(partial)
    study.write_further(results)
    findings, warnings = study.findings(results), study.warnings(results)
    if sum(len(lines) for _, lines, _ in listing.sections) <= SHOWN:
        console.print(*terminal_tables(study.config.name, listing, console.width))
    if len(warnings) > MOST_WARNINGS:
        warnings[MOST_WARNINGS:] = [f'{len(warnings) - MOST_WARNINGS} more are in study.csv']
    for text in warnings:
        console.print(f'[red]{plain(text)}[/red]', highlight=False)
    for text in findings:
        console.print(f'- {plain(text)}', highlight=False)
    drawn = study.figure(results)
    if drawn is not None:
        drawn.savefig(folder / FIGURE_FILE, dpi=DPI)
    write_page(folder / PAGE_FILE, f'Study {study.config.name}',
               _page(study, results, listing, findings, warnings, drawn is not None))
    for name in (PAGE_FILE, CSV_FILE, TABLE_FILE):
        console.print(f'results in {folder / name}', highlight=False, soft_wrap=True)


def _page(
    study: Study, results: Results, listing: Listing, findings: Sequence[str],
    warnings: Sequence[str], drawn: bool,
) -> str:
    """Return the page of a study as HTML: what came out, the figure, the tables."""
    config = study.config
    items = [*(f'<li>{escape(text)}</li>' for text in findings),
             *(f'<li class=no>{escape(text)}</li>' for text in warnings)]
    parts = [f'<p>{escape(config.description)}</p>', f'<ul>{"".join(items)}</ul>']
    if drawn:
        parts.append(image(results.folder / FIGURE_FILE, config.name))
    parts += ['<h2>Table</h2>', html_table(listing),
              f'<p class=note>{escape(config.notes)} Every run is in study.csv.</p>']
    parts += [f'<h2>{escape(heading)}</h2>{text}' for heading, text in study.sections(results)]
    settings = json.dumps(config.model_dump(mode='json', exclude_unset=True), indent=1)
    return '\n'.join([*parts, f'<details><summary>study</summary><pre>{escape(settings)}</pre>'
                      '</details>'])


def read_results(folder: Path) -> tuple[Study, Results]:
    """Return the study of a folder and what came out; ConfigError if the folder has none."""
    path = folder / STUDY_FILE
    study = study_of(validate(StudyConfig, read_yaml(path), str(path)))
    frame = pd.read_parquet(folder / TABLE_FILE)
    metrics = [read_cell(folder, key) for key in frame['key']]
    if None in metrics:
        raise RunError(f'{folder}: expected a finished job for every row of {TABLE_FILE}, got '
                       f'{metrics.count(None)} rows without')
    return study, Results([each for each in metrics if each is not None], frame, folder)
