"""How every study runs: cells, jobs, one table, one page; what a kind has beside is its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from multicontact_control import __version__
from multicontact_control.errors import format_count
from multicontact_control.files import replace_json_file
from multicontact_control.judging import page
from multicontact_control.runs.overrides import find_unit
from multicontact_control.study import table
from multicontact_control.study.cells import Cell, is_parameter, run_cells
from multicontact_control.study.config import StudyConfig
from multicontact_control.study.jobs import (
    dask_client,
    prepare_folder,
    read_cells,
    run_jobs,
)
from multicontact_control.study.measure import Metrics, metrics_row
import pandas as pd
from rich.console import Console

DPI = 130  # of the figure
MOST_WARNINGS = 20
STUDY_FILE, TABLE_FILE, CSV_FILE = 'study.json', 'study.parquet', 'study.csv'
PAGE_FILE, FIGURE_FILE, PRINTED_FIGURE_FILE = 'study.html', 'study.png', 'study.pdf'


@dataclass(frozen=True, eq=False)
class Results:
    """What came out of a study: its cells, and the table of them."""

    cells: Sequence[Cell]
    frame: pd.DataFrame  # a row for each cell; `attrs` has factors and units
    metrics: Mapping[str, Metrics]  # what was measured, by `key`


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
        """Return the table with further columns, or in another order."""
        return frame

    def findings(self, results: Results) -> list[str]:
        """Return what the numbers show, in sentences."""
        return table.sentences(results.frame, self.config)

    def figure(self, results: Results) -> Any:
        """Return the figure, None if there is none."""
        return table.draw_study(results.frame, self.config)

    def sections(self, results: Results) -> Mapping[str, str]:
        """Return what stands below the table on the page: HTML by plain heading."""
        return {}

    def results(self, cells: Sequence[Cell], metrics: Mapping[str, Metrics]) -> Results:
        """Return cells with what was measured in them, by key, as a table."""
        frame = self.complete(
            pd.DataFrame(
                [
                    {**cell.factors, **row, 'key': cell.key}
                    for cell in cells
                    for row in self.rows(metrics[cell.key])
                ]
            )
        )
        units = {
            name: find_unit(name, cells[0].job.setup())
            for name in cells[0].factors
            if is_parameter(name)
        }
        frame.attrs = {
            'factors': list(cells[0].factors),
            'units': units,
            'version': __version__,
        }
        return Results(cells, frame, metrics)

    def warnings(self, results: Results) -> list[str]:
        """Return which runs ended early and why, and which columns are not in the table."""
        frame = results.frame
        failed = frame[frame['error'].notna()]
        names = dict.fromkeys([*self.config.lines, *frame.attrs['factors'], 'seed'])
        texts = [
            ', '.join(f'{name} {row[name]}' for name in names if row[name] != '')
            + f': {row["error"]}'
            for _, row in failed.head(MOST_WARNINGS).iterrows()
        ]
        if len(failed) > MOST_WARNINGS:
            texts.append(f'{len(failed) - MOST_WARNINGS} more are in {CSV_FILE}')
        return texts + [
            f'columns: the table has nothing under {column.value}'
            for column in table.table_columns(frame, self.config)
            if column.value not in frame
            and table.worst(frame, column.value).isna().all()
        ]

    def write(self, results: Results, folder: Path) -> None:
        """Write study, table and page into the folder."""
        frame, config, warnings = results.frame, self.config, self.warnings(results)
        replace_json_file(folder / STUDY_FILE, config.model_dump(mode='json'))
        frame.to_csv(folder / CSV_FILE, index=False)
        frame.to_parquet(folder / TABLE_FILE, index=False)
        figure = self.figure(results)
        if figure is not None:
            for name in (FIGURE_FILE, PRINTED_FIGURE_FILE):
                figure.savefig(folder / name, dpi=DPI)
        page.write_page(
            folder / PAGE_FILE,
            f'Study {config.name}',
            '\n'.join(
                [
                    f'<p>{escape(config.description)}</p>',
                    _listed(self.findings(results)),
                    ''
                    if figure is None
                    else page.render_image(folder / FIGURE_FILE, config.name),
                    *(
                        f'<h2>{escape(section)}</h2>'
                        + page.render_table(
                            list(map(escape, lines)),
                            [list(map(escape, line)) for line in lines.to_numpy()],
                            numbers_from=lines.attrs['labels'],
                        )
                        for section, lines in table.listing_of(frame, config).items()
                    ),
                    f'<p class=note>{escape(config.notes)} Every run is in {CSV_FILE}.</p>',
                    page.render_details(
                        format_count(len(warnings), 'remarks'), _listed(warnings)
                    )
                    if warnings
                    else '',
                    *(
                        f'<h2>{escape(heading)}</h2>{text}'
                        for heading, text in self.sections(results).items()
                    ),
                ]
            ),
        )


def _listed(texts: Sequence[str]) -> str:
    return f'<ul>{"".join(f"<li>{escape(text)}</li>" for text in texts)}</ul>'


def run_study(
    study: Study,
    out: Path | None = None,
    *,
    jobs: int = 0,
    dask: str = '',
    dry_run: bool = False,
    overwrite: bool = False,
    console: Console | None = None,
) -> Results | None:
    """
    Run a study, write its files, and show and return what came out; None of a dry run.

    The folder is `out`, or ``runs/<name>``; `jobs` and `dask` are as for `run_jobs` and
    `dask_client`. ConfigError if the study is not acceptable, before anything is run.
    """
    console, name = console or Console(highlight=False), study.config.name
    cells, folder = study.cells(), out or Path('runs') / name
    keys = {cell.key for cell in cells}
    with dask_client(dask) as client:
        if not dry_run:
            prepare_folder(folder, overwrite=overwrite)
        console.print(
            f'study {name}: {format_count(len(keys), "jobs")}, '
            f'{len(read_cells(folder, keys))} of them finished before'
        )
        if dry_run:
            for factor in cells[0].factors:
                values = dict.fromkeys(str(cell.factors[factor]) for cell in cells)
                if any(values):
                    console.print(
                        f'  {factor}: {", ".join(filter(None, values))}',
                        markup=False,
                        soft_wrap=True,
                    )
            return None

        def run(some: Sequence[Cell]) -> dict[str, dict[str, Any]]:
            return run_jobs(
                {cell.key: cell.job for cell in some},
                folder,
                workers=jobs,
                client=client,
                console=console,
                title=name,
            )

        results = study.results(cells, run(cells))
        if further := study.further(results):
            cells += further
            results = study.results(cells, run(cells))
    study.write(results, folder)
    listing = table.listing_of(results.frame, study.config)
    console.print(*table.terminal_tables(name, listing, console.width))
    for text in study.warnings(results):
        console.print(text, style='red', markup=False)
    for text in study.findings(results):
        console.print(f'- {text}', markup=False)
    for file in (PAGE_FILE, CSV_FILE, TABLE_FILE):
        console.print(f'results in {folder / file}', soft_wrap=True)
    return results
