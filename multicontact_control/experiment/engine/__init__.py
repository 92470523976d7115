"""
Many runs at once: cells, each described in full, run once, and kept in a folder.

A cell is named by the hash of everything that decides its outcome, so that an interrupted
matrix goes on where it stopped and a changed configuration is run again. What carries the cells
out is an `Executor`: processes of this machine, or a Dask cluster.
"""

from multicontact_control.experiment.engine.cells import (
    Cell,
    cell_of,
    CellResult,
    Executor,
    LostCell,
    Outcome,
    RunCell,
)
from multicontact_control.experiment.engine.local import LocalExecutor, usable_cores
from multicontact_control.experiment.engine.run import CellRun, run_cells
from multicontact_control.experiment.engine.store import CellStore, prepare_cell_folder

__all__ = [
    'Cell', 'CellResult', 'CellRun', 'CellStore', 'Executor', 'LocalExecutor', 'LostCell',
    'Outcome', 'RunCell', 'cell_of', 'prepare_cell_folder', 'run_cells', 'usable_cores']
