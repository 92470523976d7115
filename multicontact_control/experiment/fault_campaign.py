"""The fault campaign: many faults, each in a process forked from a running scenario."""

from __future__ import annotations

from collections.abc import Callable
import json
import multiprocessing
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from multicontact_control.errors import RunError
from multicontact_control.experiment.fault_run import FaultRow, run_fault, World
from multicontact_control.experiment.faults import (
    APPROACH,
    fault_kinds,
    FaultKind,
    PHASES,
    REST,
    SLIDING,
)
from multicontact_control.experiment.scenario import resolve
from rich.console import Console
from rich.table import Table

PLANTS = ('rigid', 'puma')
PHASE_TIMES = {APPROACH: 0.65, REST: 4.9, SLIDING: 8.2}
SEEDS, QUICK_SEEDS = 14, 1
FAULT_TIMEOUT = 60.0
REPORT_FILE = 'faults.json'

Task = tuple[int, int]  # index of the kind, seed


def situation(number: int) -> tuple[str, str]:
    """Return plant and phase of the number-th seed of a kind: all pairs in turn."""
    return PLANTS[number % 2], PHASES[number // 2 % 3]


def run_campaign(
    seed: int, *, quick: bool = False, jobs: int = 2,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[FaultRow]:
    """
    Run all faults.

    Every worker runs the scenario `quick` once per plant; where a phase begins, it forks a
    process per fault, so that none costs the way there.

    Parameters
    ----------
    seed
        Seeds of the faults count from here.
    quick
        One fault of each kind instead of 14.
    jobs
        Worker processes.
    on_progress
        Called with the faults done and all.

    Returns
    -------
    list of FaultRow
        By kind and seed.

    """
    kinds = fault_kinds()
    seeds = QUICK_SEEDS if quick else SEEDS
    tasks = [(kind, seed + number) for kind in range(len(kinds)) for number in range(seeds)]
    if quick:  # one of each, yet in every situation
        tasks = [(kind, seed + kind % 6) for kind in range(len(kinds))]
    context = multiprocessing.get_context('fork')
    pipes, workers = [], []
    for part in range(max(jobs, 1)):
        ours, theirs = context.Pipe(duplex=False)
        worker = context.Process(target=_work, args=(tasks[part::max(jobs, 1)], seed, theirs))
        worker.start()
        theirs.close()
        pipes.append(ours)
        workers.append(worker)
    rows = _collect(pipes, len(tasks), on_progress)
    for worker in workers:
        worker.join()
    if len(rows) != len(tasks):
        raise RunError(f'fault campaign: expected {len(tasks)} faults, found {len(rows)}')
    order = {(kind.kind, kind.input): i for i, kind in enumerate(kinds)}
    return sorted(rows, key=lambda row: (order[row.kind, row.input], row.seed))


def _collect(
    pipes: list[Any], total: int, on_progress: Callable[[int, int], None] | None,
) -> list[FaultRow]:
    rows: list[FaultRow] = []
    while pipes:
        ready: list[Any] = list(wait(pipes))
        for pipe in ready:
            try:
                rows.append(pipe.recv())
            except EOFError:
                pipes.remove(pipe)
            if on_progress is not None:
                on_progress(len(rows), total)
    return rows


def _work(tasks: list[Task], first_seed: int, pipe: Connection) -> None:
    """Run faults, grouped by plant and in the order of the phases."""
    kinds = fault_kinds()
    for plant in PLANTS:
        world: World | None = None
        for phase, start in sorted(PHASE_TIMES.items(), key=lambda item: item[1]):
            here = [task for task in tasks if situation(task[1] - first_seed) == (plant, phase)]
            if not here:
                continue
            if world is None:
                world = World(resolve('quick', plant=plant, seed=first_seed))
            while world.tick < round(start * world.setup.controller.rate):
                world.advance()
            for kind, seed in here:
                pipe.send(_in_fork(world, kinds[kind], seed, phase))
    pipe.close()


def _in_fork(world: World, kind: FaultKind, seed: int, phase: str) -> FaultRow:
    """Run one fault in a copy of this process; a copy that hangs or dies is not safe."""
    context = multiprocessing.get_context('fork')
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_child, args=(world, kind, seed, phase, theirs))
    child.start()
    theirs.close()
    try:
        if ours.poll(FAULT_TIMEOUT):
            row: FaultRow = ours.recv()
            return row
        problem = 'hang'
    except EOFError:
        problem = 'died'
    finally:
        child.kill() if child.is_alive() and not ours.poll(0) else None
        child.join()
        ours.close()
    return FaultRow(kind.kind, kind.input, seed, problem, -1.0, -1.0, -1.0, False,
                    world.setup.plant_name, phase, problem)


def _child(world: World, kind: FaultKind, seed: int, phase: str, pipe: Connection) -> None:
    pipe.send(run_fault(world, kind, seed, phase))
    pipe.close()


def write_report(folder: Path, rows: list[FaultRow]) -> Path:
    """Write ``faults.json`` into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / REPORT_FILE
    report: dict[str, Any] = {'faults': [row.as_json() for row in rows]}
    path.write_text(json.dumps(report, indent=1) + '\n', encoding='utf-8')
    return path


def fault_table(rows: list[FaultRow]) -> Table:
    """Return one line per kind."""
    table = Table(title='faults', title_justify='left', box=None)
    for name, justify in (('input', 'left'), ('kind', 'left'), ('n', 'right'),
                          ('reaction', 'left'), ('to safe [ms]', 'right'),
                          ('force [N]', 'right'), ('torque', 'right'), ('safe', 'left')):
        table.add_column(name, justify=justify)  # type: ignore[arg-type]
    groups: dict[tuple[str, str], list[FaultRow]] = {}
    for row in rows:
        groups.setdefault((row.input, row.kind), []).append(row)
    for (source, kind), group in groups.items():
        reactions = sorted({row.reaction for row in group})
        slowest = max(row.time_to_safe_s for row in group)
        unsafe = sum(not row.safe for row in group)
        problems = sorted({row.problems for row in group if not row.safe})
        table.add_row(
            source, kind, str(len(group)), ', '.join(reactions), f'{1e3 * slowest:.0f}',
            f'{max(row.peak_force_n for row in group):.1f}',
            f'{max(row.peak_torque_fraction for row in group):.2f}',
            '[green]yes[/]' if not unsafe else f'[red]{unsafe} not: {"; ".join(problems)}[/]')
    return table


def print_report(rows: list[FaultRow], console: Console) -> None:
    """Print the table and one line of verdict."""
    console.print(fault_table(rows))
    unsafe = sum(not row.safe for row in rows)
    console.print(f'{len(rows)} faults of {len({(r.input, r.kind) for r in rows})} kinds, '
                  f'{unsafe} unsafe', highlight=False)
