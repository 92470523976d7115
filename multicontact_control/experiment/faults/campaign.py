"""The fault campaign: many faults in every situation, judged and tabled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from multicontact_control.experiment.engine import (
    LocalExecutor,
    prepare_cell_folder,
    run_cells,
)
from multicontact_control.experiment.faults.cells import (
    Fault,
    FaultCell,
    PHASE_TIMES,
    run_fault_cell,
)
from multicontact_control.experiment.faults.in_process import FaultRow
from multicontact_control.experiment.faults.vocabulary import fault_kinds, PHASES
from multicontact_control.experiment.results import write_json
from multicontact_control.experiment.scenario import PLANTS
from rich.console import Console
from rich.markup import escape
from rich.table import Table

SEEDS = 14
FAULTS_PER_CELL = 12
REPORT_FILE = 'faults.json'
PLACES = {'process': 'in process', 'graph': 'over the graph'}


def situation(number: int) -> tuple[str, str]:
    """Return plant and phase of the number-th seed of a kind: all pairs in turn."""
    return PLANTS[number % 2], PHASES[number // 2 % 3]


def campaign_cells(seed: int, *, quick: bool = False) -> list[FaultCell]:
    """
    Return the cells of a campaign, early phases first.

    In this order a worker that has got to one phase only has to go on to the next.

    Parameters
    ----------
    seed
        Seeds of the faults count from here.
    quick
        One fault of each kind instead of 14.

    """
    places: dict[tuple[str, str], list[Fault]] = {
        (plant, phase): [] for phase in sorted(PHASE_TIMES, key=PHASE_TIMES.__getitem__)
        for plant in PLANTS}
    for index, kind in enumerate(fault_kinds()):
        # One of each, yet in every situation.
        for number in (index % 6,) if quick else range(SEEDS):
            places[situation(number)].append((kind.kind, kind.input, seed + number))
    return [FaultCell(plant, phase, seed, tuple(faults[i:i + FAULTS_PER_CELL]))
            for (plant, phase), faults in places.items()
            for i in range(0, len(faults), FAULTS_PER_CELL)]


def run_campaign(
    seed: int, folder: Path, *, quick: bool = False, jobs: int = 0, overwrite: bool = False,
    console: Console | None = None,
) -> list[FaultRow]:
    """
    Run all faults that have no result yet.

    Parameters
    ----------
    seed
        Seeds of the faults count from here.
    folder
        Where results are kept, and looked for.
    quick
        One fault of each kind instead of 14.
    jobs
        Worker processes, 0 for every core.
    overwrite
        Whether finished faults are run again.
    console
        Where progress is shown.

    Returns
    -------
    list of FaultRow
        By kind and seed.

    """
    executor = LocalExecutor(jobs)
    prepare_cell_folder(folder, overwrite=overwrite, results=[REPORT_FILE])
    cells = campaign_cells(seed, quick=quick)
    run = run_cells(cells, folder, run_fault_cell, executor=executor, console=console,
                    title='faults')
    rows = [FaultRow(**row) for cell in cells for row in run.result(cell).metrics['rows']]
    order = {(kind.kind, kind.input): i for i, kind in enumerate(fault_kinds())}
    return sorted(rows, key=lambda row: (order[row.kind, row.input], row.seed))


def write_report(folder: Path, rows: list[FaultRow]) -> Path:
    """Write ``faults.json`` into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / REPORT_FILE
    report: dict[str, Any] = {'faults': [row.as_json() for row in rows]}
    write_json(path, report)
    return path


def fault_table(rows: list[FaultRow]) -> Table:
    """Return one line per kind, by where it happened."""
    table = Table(title='faults', title_justify='left', box=None, padding=(0, 1, 0, 0))
    for name in ('input', 'kind', 'n', 'reaction', 'to safe [ms]', 'force [N]', 'torque', 'safe'):
        number = name in ('n', 'to safe [ms]', 'force [N]', 'torque')
        table.add_column(name, justify='right' if number else 'left', no_wrap=name in (
            'input', 'kind'))
    groups: dict[tuple[str, str, str], list[FaultRow]] = {}
    for row in rows:
        groups.setdefault((row.where, row.input, row.kind), []).append(row)
    before = ''
    for (where, source, kind), group in groups.items():
        if where != before:
            table.add_row(f'[bold]{PLACES[where]}[/]')
            before = where
        reactions = sorted({row.reaction for row in group})
        slowest = max(row.time_to_safe_s for row in group)
        never = any(row.time_to_safe_s < 0.0 for row in group)
        unsafe = sum(not row.safe for row in group)
        table.add_row(
            source.removesuffix('_node'), kind, str(len(group)), ', '.join(reactions),
            'never' if never else f'{1e3 * slowest:.0f}',
            f'{max(row.peak_force_n for row in group):.1f}',
            f'{max(row.peak_torque_fraction for row in group):.2f}',
            '[green]yes[/]' if not unsafe else f'[red]{unsafe} not[/]')
    return table


def print_report(rows: list[FaultRow], console: Console) -> None:
    """Print the table, a line for each fault that was not safe, and one of verdict."""
    console.print(fault_table(rows))
    unsafe = [row for row in rows if not row.safe]
    for row in unsafe:
        console.print(f'[red]not safe:[/] {row.where}, {row.plant}, {row.input} {row.kind}, seed '
                      f'{row.seed}: {escape(row.problems)}', highlight=False)
    kinds = {(row.where, row.input, row.kind) for row in rows}
    console.print(
        f'{len(rows)} faults of {len(kinds)} kinds, {len(unsafe)} unsafe', highlight=False)
