"""What the command `sweep` does, from its options to its files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.engine import (
    CellRun,
    LocalExecutor,
    prepare_cell_folder,
    run_cells,
    RunCell,
)
from multicontact_control.experiment.engine.cluster import DaskExecutor
from multicontact_control.experiment.runtime_estimate import estimate_time
from multicontact_control.experiment.sweep.groups import chosen_metrics, groups_of
from multicontact_control.experiment.sweep.measure import summarise_cell
from multicontact_control.experiment.sweep.page import group_table, write_sweep_page
from multicontact_control.experiment.sweep.plan import plan_sweep, SweepPlan
from multicontact_control.experiment.sweep.study import read_study, study_path
from multicontact_control.experiment.sweep.table import (
    Row,
    row_of,
    sweep_table,
    TABLE_FILE,
    write_table,
)
from multicontact_control.experiment.verdict import HELD
import pyarrow as pa
from rich.console import Console
import yaml

STUDY_FILE = 'study.yaml'
TIMINGS_FILE = 'timings.csv'
SHOWN = 40  # lines of the table over the seeds that still fit a terminal


@dataclass(frozen=True)
class SweepRequest:
    """
    The options of `multicontact sweep`.

    Attributes
    ----------
    study
        Name or path.
    out
        Folder; None for ``runs/sweep-<name of the study>``.
    seeds
        Instead of the study's; None for those.
    jobs
        Runs at once on this machine, 0 for every core.
    dask
        Address of a Dask scheduler to use instead, empty for none.
    dry_run, overwrite
        Whether only to say what would be done; whether finished runs are run again.

    """

    study: str
    out: Path | None = None
    seeds: tuple[int, ...] | None = None
    jobs: int = 0
    dask: str = ''
    dry_run: bool = False
    overwrite: bool = False


def sweep_and_report(request: SweepRequest, console: Console | None = None) -> None:
    """
    Run a study, show its table, write its files.

    Parameters
    ----------
    request
        What is asked for.
    console
        Where it is shown.

    Raises
    ------
    ConfigError
        If study or options are not acceptable, before anything is run.
    RunError
        If runs were lost; all others are in the table.

    """
    console = console or Console()
    path = study_path(request.study)
    plan = plan_sweep(read_study(path, seeds=request.seeds), str(path))
    out = request.out or Path('runs') / f'sweep-{plan.study.name}'
    with _executor(request) as executor:
        if not request.dry_run:
            prepare_cell_folder(out, overwrite=request.overwrite)
        cells = [run.cell for run in plan.runs]
        jobs = max(executor.jobs, 1)
        # A probe takes longer than starting the workers; their progress bar tells the time left.
        estimate = estimate_time(cells, out, jobs, probe=request.dry_run)
        console.print(f'study {plan.study.name}: {len(groups_of(plan))} combinations with '
                      f'{len(plan.study.seeds)} seeds', highlight=False)
        console.print(estimate.sentence(jobs), highlight=False)
        if request.dry_run:
            return
        run = run_cells(cells, out, summarise_cell, executor=executor, console=console,
                        title='sweep')
    table = write_results(plan, run, out)
    _show(plan, table, out, console)
    if run.lost:
        raise RunError(f'{len(run.lost)} of {len(cells)} runs were lost (see the column `error`); '
                       'the same command tries them again')


@contextmanager
def _executor(request: SweepRequest) -> Iterator[LocalExecutor | DaskExecutor]:
    """Open what the cells are run by."""
    if not request.dask:
        yield LocalExecutor(request.jobs)
        return
    if request.jobs:
        raise ConfigError('jobs', 'nothing together with --dask, whose workers decide',
                          request.jobs)
    with DaskExecutor(request.dask) as executor:
        yield executor


def write_results(plan: SweepPlan, run: CellRun[RunCell], folder: Path) -> pa.Table:
    """Write study, table and wall times of a sweep; return the table."""
    rows: list[Row] = []
    walls = []
    for one in plan.runs:
        key = {'key': run.keys[one.cell]}
        if one.cell in run.lost:
            rows.append(row_of({}, run.lost[one.cell]) | key)
            continue
        result = run.result(one.cell)
        rows.append(row_of(result.metrics) | key)
        walls.append(f"{one.number},{key['key']},{result.wall_time:.4f}\n")
    table = sweep_table(plan, rows)
    write_table(table, folder / TABLE_FILE)
    # Apart from the table, which shall be the same whatever ran it.
    (folder / TIMINGS_FILE).write_text('run,key,wall_s\n' + ''.join(walls), encoding='utf-8')
    (folder / STUDY_FILE).write_text(
        yaml.safe_dump(plan.study.model_dump(mode='json'), sort_keys=False), encoding='utf-8')
    return table


def _show(plan: SweepPlan, table: pa.Table, folder: Path, console: Console) -> None:
    metrics, missing = chosen_metrics(table, plan.study.figures)
    for name in missing:
        console.print(f'figures: the table has no numbers under {name}', style='yellow',
                      highlight=False)
    if metrics:
        if len(groups_of(plan)) <= SHOWN:
            console.print(group_table(plan, table, metrics))
        paths = write_sweep_page(plan, table, metrics, folder)
    else:
        paths = []
    stable = sum(table['stable'].to_pylist())
    ended = sum(error is not None for error in table['error'].to_pylist())
    held = table['verdict'].to_pylist().count(HELD)
    console.print(f'{table.num_rows} runs: {stable} stable, {table.num_rows - stable} not, of '
                  f'which {ended} ended early and {held} were held by the supervisor',
                  highlight=False, soft_wrap=True)
    for path in (folder / TABLE_FILE, *paths):
        console.print(f'results in {path}', highlight=False, soft_wrap=True)
