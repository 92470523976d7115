"""What `compare` and `map` are asked for alike, and how both begin."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from multicontact_control.experiment.engine import (
    LocalExecutor,
    prepare_cell_folder,
    RunCell,
)
from multicontact_control.experiment.runtime_estimate import estimate_time
from rich.console import Console


@dataclass(frozen=True)
class MatrixRequest:
    """
    The options of a command that runs a matrix.

    Attributes
    ----------
    plants, estimators
        Names; none for all, or those of the quick matrix.
    jobs
        Runs at once, 0 for every core.
    quick, overwrite
        The reduced matrix; whether finished cells are run again.
    out
        Folder.

    """

    plants: tuple[str, ...]
    estimators: tuple[str, ...]
    jobs: int
    quick: bool
    out: Path
    overwrite: bool

    def begin(self, cells: Iterable[RunCell], console: Console) -> LocalExecutor:
        """
        Make the folder, say how long the cells will take, and return who runs them.

        Parameters
        ----------
        cells
            The matrix.
        console
            Where it is said.

        Raises
        ------
        ConfigError
            If an option is not acceptable.

        """
        executor = LocalExecutor(self.jobs)
        prepare_cell_folder(self.out, overwrite=self.overwrite)
        estimate = estimate_time(cells, self.out, executor.jobs)
        console.print(estimate.sentence(executor.jobs), highlight=False)
        return executor
