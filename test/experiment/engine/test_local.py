"""Processes of this machine, and what happens when one is killed."""

import os

from mortal_cells import kill_task, make_cells, starts
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.engine import (
    CellStore,
    LocalExecutor,
    run_cells,
)
import pytest
from rich.console import Console


def run(tmp_path, cells, jobs=2):
    with (tmp_path / 'terminal.txt').open('w') as file:
        done = run_cells(cells, tmp_path / 'out', kill_task, executor=LocalExecutor(jobs),
                         console=Console(file=file, width=200))
    return done, (tmp_path / 'terminal.txt').read_text()


def test_killed_worker_loses_nothing(tmp_path):
    """The pool is made anew; what had a result before is not run again."""
    cells = make_cells(tmp_path, [0] * 9 + [1] + [0] * 10)
    done, text = run(tmp_path, cells)
    assert done.lost == {}
    assert [done.result(cell).metrics['number'] for cell in cells] == list(range(20))
    assert 'a worker died' in text
    assert len(starts(cells[9])) == 2
    assert sum(len(starts(cell)) for cell in cells) <= 20 + 4  # at most what was given out
    assert len(starts(cells[0])) == 1


def test_cell_that_always_kills_its_worker_is_given_up_alone(tmp_path):
    cells = make_cells(tmp_path, [0, 0, 99, 0, 0, 0])
    done, text = run(tmp_path, cells)
    assert list(done.lost) == [cells[2]]
    assert len(starts(cells[2])) == 3
    assert 'given up' in text
    store = CellStore(tmp_path / 'out')
    assert [store.finished(cell.key()) for cell in cells] == [True, True, False, True, True, True]


def test_workers_have_one_numerical_thread(tmp_path):
    cells = make_cells(tmp_path, [0, 0])
    done, _ = run(tmp_path, cells)
    pids = {path.name.split('-')[1] for cell in cells for path in starts(cell)}
    assert str(os.getpid()) not in pids
    for cell in cells:
        assert set(done.result(cell).metrics['environment'].values()) == {'1'}


def test_one_job_runs_in_this_process(tmp_path):
    cells = make_cells(tmp_path, [0, 0])
    run(tmp_path, cells, jobs=1)
    assert {path.name.split('-')[1] for cell in cells for path in starts(cell)} == {
        str(os.getpid())}


def task_that_no_worker_can_import(cell):
    """Lie in a module that only pytest knows."""


def test_work_that_cannot_be_handed_over_is_said_to_be_so(tmp_path):
    cells = make_cells(tmp_path, [0, 0])
    with pytest.raises(RunError, match='the workers cannot run anything'):
        list(LocalExecutor(2).results(task_that_no_worker_can_import, cells, print))


def test_number_of_jobs_is_checked():
    with pytest.raises(ConfigError, match='jobs: expected a whole number >= 0, found -1'):
        LocalExecutor(-1)
