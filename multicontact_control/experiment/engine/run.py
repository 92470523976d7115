"""Run every cell that is not finished yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Generic

from multicontact_control.errors import RunError
from multicontact_control.experiment.compilation import ensure_compiled
from multicontact_control.experiment.engine.cells import (
    CellResult,
    CellT,
    Executor,
    LostCell,
)
from multicontact_control.experiment.engine.local import LocalExecutor
from multicontact_control.experiment.engine.store import CellStore
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


@dataclass(frozen=True)
class CellRun(Generic[CellT]):
    """
    What came of the cells of a matrix.

    Attributes
    ----------
    store
        Where the results are.
    keys
        The key of every cell.
    lost
        Why a cell has no result, for those that have none.

    """

    store: CellStore
    keys: Mapping[CellT, str]
    lost: Mapping[CellT, str]

    def result(self, cell: CellT) -> CellResult:
        """
        Return the result of a cell.

        Raises
        ------
        RunError
            If it has none.

        """
        result = self.store.load(self.keys[cell])
        if result is None:
            why = self.lost.get(cell, 'it was changed meanwhile')
            raise RunError(f'{self.store.folder}/{self.keys[cell]}: expected a finished cell: '
                           f'{why}')
        return result


def run_cells(
    cells: Sequence[CellT], folder: Path, task: Callable[[CellT], CellResult], *,
    executor: Executor | None = None, console: Console | None = None, title: str = 'cells',
) -> CellRun[CellT]:
    """
    Run every cell that is not finished yet.

    Parameters
    ----------
    cells
        The matrix; a cell that comes twice is run once.
    folder
        Where results are kept, and looked for.
    task
        What a cell is run with: an importable function.
    executor
        Who runs them; all cores of this machine if not given.
    console
        Where the progress bar is shown, with the time left.
    title
        Left of the bar.

    Returns
    -------
    CellRun
        Access to the results.

    Raises
    ------
    ConfigError
        If a cell's configuration is not acceptable, before anything is run.

    """
    store = CellStore(folder)
    keys = {cell: cell.key() for cell in cells}
    todo = list({key: cell for cell, key in keys.items() if not store.finished(key)}.values())
    lost: dict[str, str] = {}
    if todo:
        ensure_compiled(console)  # here once, not in every worker at once
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(),
               TimeElapsedColumn(), TextColumn('left'), TimeRemainingColumn())
    with Progress(*columns, console=console, refresh_per_second=2,
                  speed_estimate_period=600.0) as progress:
        bar = progress.add_task(title, total=len(set(keys.values())),
                                completed=len(set(keys.values())) - len(todo))

        def notify(text: str) -> None:
            progress.console.print(f'{title}: {text}', highlight=False, markup=False)

        if todo:
            work = (executor or LocalExecutor()).results(task, todo, notify)
            with closing(work) as outcomes:
                for cell, outcome in outcomes:
                    if isinstance(outcome, LostCell):
                        lost[keys[cell]] = outcome.reason
                    else:
                        store.save(keys[cell], cell, outcome)
                    progress.advance(bar)
    return CellRun(store, keys, {cell: lost[key] for cell, key in keys.items() if key in lost})
