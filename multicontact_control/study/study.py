"""
How every study runs: its cells as jobs, one table, one page.

Each kind of study overrides parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from multicontact_control import __version__
from multicontact_control.errors import format_count
from multicontact_control.files import replace_json_file
from multicontact_control.judging import page
from multicontact_control.runs.overrides import find_unit
from multicontact_control.study import table
from multicontact_control.study.cells import Cell, is_parameter_name, plan_runs
from multicontact_control.study.config import StudyConfig
from multicontact_control.study.jobs import (
    dask_client,
    prepare_folder,
    read_finished,
    run_jobs,
)
from multicontact_control.study.measure import Metrics, metrics_row
import pandas as pd
from rich.console import Console

DPI = 130  # of the figure
# on runs that ended early; a study that fails as a whole has thousands.
MOST_REMARKS = 20
STUDY_FILE = 'study.json'
TABLE_FILE = 'study.parquet'
CSV_FILE = 'study.csv'
PAGE_FILE = 'study.html'
FIGURE_FILE = 'study.png'
PRINTED_FIGURE_FILE = 'study.pdf'


@dataclass(frozen=True, eq=False)
class Results:
    """
    What came out of a study: its cells, what was measured in them, and the table of it.

    `attrs` of the frame has the names of the factors, their units by dotted name, and the version
    of the package. Hashed by identity: `MapStudy` caches the boundaries that its sentences and its
    figure share.
    """

    cells: Sequence[Cell]
    frame: pd.DataFrame  # the rows of all cells, usually one for each
    metrics: Mapping[str, Metrics]  # what was measured, by `Cell.key`


class Study:
    """
    A study as its file describes it, with a row for each run in its table.

    A kind of study with code of its own (`StudyConfig.kind`) is a subclass in `study.presets`,
    which replaces some of these methods; `run_study` calls them. The configuration's parts are
    whole, as `read_study` returns them.
    """

    def __init__(self, config: StudyConfig) -> None:
        self.config = config

    def plan_cells(self) -> list[Cell]:
        """
        Return every cell of the first round, each with its job and key.

        All are planned before any is run, so that a value which is not acceptable stops the study
        at once and not after an hour.

        Raises
        ------
        ConfigError
            If a cell is not acceptable; it names part and factors.

        """
        return plan_runs(self.config)

    def plan_further_cells(self, results: Results) -> list[Cell]:
        """
        Return the cells that follow from the results of the first, none in most studies.

        They join the first ones in one table. `TuneStudy` tries the best gains on other seeds with
        it.
        """
        return []

    def table_rows(self, metrics: Metrics) -> list[dict[str, Any]]:
        """
        Return the rows of the table that the metrics of a cell make, by column.

        `metrics` is what the cell's job returned. A run makes one row; a job of several faults
        makes one for each. The factors of the cell are added to every row.
        """
        return [metrics_row(metrics)]

    def complete_table(self, frame: pd.DataFrame) -> pd.DataFrame:
        """
        Return the table with further columns, or in another order.

        Every study's table has `error`, None in rows without one, and the column
        `StudyConfig.truth`; a kind whose rows lack them adds them here.
        """
        return frame

    def describe_findings(self, results: Results) -> list[str]:
        """
        Return what the numbers show, in sentences that open page and terminal output.

        They are plain text, which the page escapes. The usual ones say in how many runs the
        study's truth holds, and at which values of its factors.
        """
        return table.describe_good_runs(results.frame, self.config)

    def draw_figure(self, results: Results) -> Figure | None:
        """
        Return the figure, None if there is nothing to draw.

        It is written as PNG for the page and as PDF for print. The usual one has the columns of
        the table over the first factor.
        """
        return table.draw_study(results.frame, self.config)

    def further_sections(self, results: Results) -> Mapping[str, str]:
        """
        Return what stands below the table on the page: HTML by plain heading.

        The text is put on the page as it is; a kind escapes what comes from files. The usual study
        has nothing more to show.
        """
        return {}

    def tabulate(
        self, cells: Sequence[Cell], metrics: Mapping[str, Metrics]
    ) -> Results:
        """
        Return cells with what was measured in them, by key, as a table.

        Cells that share a job have rows of their own with the same numbers. A column `key` leads
        from each row to its file under `cells/`.
        """
        rows = []
        for cell in cells:
            for row in self.table_rows(metrics[cell.key]):
                rows.append({**cell.factors, **row, 'key': cell.key})
        frame = self.complete_table(pd.DataFrame(rows))
        factors = list(cells[0].factors)
        setup = cells[0].job.setup()
        units = {}
        for name in factors:
            if is_parameter_name(name):
                units[name] = find_unit(name, setup)
        frame.attrs = {'factors': factors, 'units': units, 'version': __version__}
        return Results(cells, frame, metrics)

    def list_remarks(self, results: Results) -> list[str]:
        """
        Return the runs with an `error`, each with its error, and the columns that no row has.

        At most `MOST_REMARKS` runs are named by their factors and seed, with a count of the
        others. A column that no row has is most likely misspelt in the study's file.
        """
        frame = results.frame
        failed = frame[frame['error'].notna()]
        # The seed is no factor of a cell with several faults: each of its rows has one.
        names = dict.fromkeys([*self.config.lines, *frame.attrs['factors'], 'seed'])
        remarks = []
        for _, row in failed.head(MOST_REMARKS).iterrows():
            # '' stands in the cells of a part that does not have the factor.
            where = [f'{name} {row[name]}' for name in names if row[name] != '']
            remarks.append(f'{", ".join(where)}: {row["error"]}')
        if len(failed) > MOST_REMARKS:
            remarks.append(f'{len(failed) - MOST_REMARKS} more are in {CSV_FILE}')
        for column in table.resolve_columns(frame, self.config):
            numbers = table.largest_of_columns(frame, column.value)
            if column.value not in frame and numbers.isna().all():
                remarks.append(f'columns: the table has nothing under {column.value}')
        return remarks

    def write_files(self, results: Results, folder: Path) -> None:
        """
        Write study, table, figure and page into the folder.

        The table is written as CSV to read and as Parquet with its types; `study.json` is the
        configuration as it was run, with all that a user chose.
        """
        frame = results.frame
        replace_json_file(folder / STUDY_FILE, self.config.model_dump(mode='json'))
        frame.to_csv(folder / CSV_FILE, index=False)
        frame.to_parquet(folder / TABLE_FILE, index=False)
        image = ''
        figure = self.draw_figure(results)
        if figure is not None:
            for name in (FIGURE_FILE, PRINTED_FIGURE_FILE):
                figure.savefig(folder / name, dpi=DPI)
            image = page.render_image(folder / FIGURE_FILE, self.config.name)
        page.write_page(
            folder / PAGE_FILE,
            f'Study {self.config.name}',
            self._render_page_body(results, image),
        )

    def _render_page_body(self, results: Results, image: str) -> str:
        """Return the page below its title as HTML: findings, figure, tables, remarks."""
        config = self.config
        parts = [
            f'<p>{escape(config.description)}</p>',
            _render_bullet_list(self.describe_findings(results)),
            image,
        ]
        for section, listed in table.make_listing(results.frame, config).items():
            head = list(map(escape, listed.columns))
            rows = [list(map(escape, row)) for row in listed.to_numpy()]
            html = page.render_table(head, rows, numbers_from=listed.attrs['labels'])
            parts.append(f'<h2>{escape(section)}</h2>{html}')
        parts.append(
            f'<p class=note>{escape(config.notes)} Every run is in {CSV_FILE}.</p>'
        )
        remarks = self.list_remarks(results)
        if remarks:
            title = format_count(len(remarks), 'remarks')
            parts.append(page.render_details(title, _render_bullet_list(remarks)))
        for heading, text in self.further_sections(results).items():
            parts.append(f'<h2>{escape(heading)}</h2>{text}')
        return '\n'.join(parts)


def _render_bullet_list(texts: Sequence[str]) -> str:
    """Return plain texts as a list in HTML."""
    items = [f'<li>{escape(text)}</li>' for text in texts]
    return f'<ul>{"".join(items)}</ul>'


def run_study(
    study: Study,
    folder: Path,
    console: Console,
    *,
    jobs: int = 0,
    dask: str = '',
    overwrite: bool = False,
) -> Results:
    """
    Run a study, write its files into a folder, and show and return what came out.

    Parameters
    ----------
    study
        What is run.
    folder
        Of the results; what is finished there is not run again.
    console
        Where progress and results are shown.
    jobs
        How many processes run jobs: 1 is this one, 0 stands for one on every core.
    dask
        Address of the scheduler of a Dask cluster that runs the jobs instead; see `dask_client`.
    overwrite
        Whether what is finished is run again.

    Raises
    ------
    ConfigError
        If the study, the folder or the address of the cluster is not acceptable, before anything
        is run.
    RunError
        If a worker or the cluster dies; what is finished is kept.

    """
    name = study.config.name
    cells = study.plan_cells()
    # First the cluster: where none answers, no folder is made, and none is emptied.
    with dask_client(dask) as client:
        prepare_folder(folder, overwrite=overwrite)
        _show_progress(name, cells, folder, console)

        def run_cells(chosen: Sequence[Cell]) -> Results:
            """Run the jobs of cells that are not finished, and return the table of all of them."""
            jobs_by_key = {cell.key: cell.job for cell in chosen}
            metrics = run_jobs(
                jobs_by_key,
                folder,
                workers=jobs,
                client=client,
                console=console,
                title=name,
            )
            return study.tabulate(chosen, metrics)

        results = run_cells(cells)
        further = study.plan_further_cells(results)
        if further:
            results = run_cells([*cells, *further])
    study.write_files(results, folder)
    listing = table.make_listing(results.frame, study.config)
    console.print(*table.terminal_tables(name, listing, console.width))
    for text in study.list_remarks(results):
        console.print(text, style='red', markup=False)
    for text in study.describe_findings(results):
        console.print(f'- {text}', markup=False)
    for file in (PAGE_FILE, CSV_FILE, TABLE_FILE):
        console.print(f'results in {folder / file}', soft_wrap=True)
    return results


def _show_progress(
    name: str, cells: Sequence[Cell], folder: Path, console: Console
) -> None:
    """Print how many jobs the cells have, and how many are finished in a study's folder."""
    keys = {cell.key for cell in cells}
    console.print(
        f'study {name}: {format_count(len(keys), "jobs")}, '
        f'{len(read_finished(folder, keys))} of them finished before'
    )


def show_plan(study: Study, folder: Path, console: Console) -> None:
    """
    Print how much of a study is finished in a folder, and every factor with its values.

    Nothing is run, and the folder need not exist. Factors without values are left out.

    Raises
    ------
    ConfigError
        If the study is not acceptable.

    """
    cells = study.plan_cells()
    _show_progress(study.config.name, cells, folder, console)
    for factor in cells[0].factors:
        texts = dict.fromkeys(str(cell.factors[factor]) for cell in cells)
        texts.pop('', None)
        if texts:
            line = f'  {factor}: {", ".join(texts)}'
            console.print(line, markup=False, soft_wrap=True)
