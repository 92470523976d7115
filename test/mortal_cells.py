"""Cells that kill whatever runs them; in a module that workers can import."""

from dataclasses import dataclass
import os
from pathlib import Path
import signal
import time

from multicontact_control.experiment.engine import CellResult
from multicontact_control.process import THREAD_VARIABLES


@dataclass(frozen=True)
class KillCell:
    """A piece of work that kills its worker some times before it gets done."""

    folder: str
    number: int
    deaths: int = 0

    def key(self):
        return f'cell{self.number}'

    def describe(self):
        return {'number': self.number}


def kill_task(cell):
    """Note the start, wait a little, and die by SIGKILL as often as the cell says."""
    (Path(cell.folder) / f'{cell.number}-{os.getpid()}-{time.monotonic_ns()}').touch()
    time.sleep(0.02)
    if len(starts(cell)) <= cell.deaths:
        os.kill(os.getpid(), signal.SIGKILL)
    return CellResult({'number': cell.number, 'environment': {
        name: os.environ.get(name) for name in THREAD_VARIABLES}}, {}, 0.02)


def starts(cell):
    return list(Path(cell.folder).glob(f'{cell.number}-*'))


def make_cells(tmp_path, deaths):
    notes = tmp_path / 'notes'
    notes.mkdir()
    return [KillCell(str(notes), number, count) for number, count in enumerate(deaths)]
