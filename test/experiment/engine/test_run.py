from dataclasses import dataclass, field
import json

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.engine import (
    cell_of,
    CellResult,
    CellStore,
    LocalExecutor,
    LostCell,
    run_cells,
)
from multicontact_control.experiment.measure import measure_cell
from multicontact_control.experiment.results import finite
import numpy as np
import pytest


def seed_task(cell):
    return CellResult({'seed': cell.seed}, {'series': np.full((3, 2), float(cell.seed))}, 0.5)


@dataclass
class CountingExecutor:
    """Runs cells here, last one first, and remembers them."""

    ran: list = field(default_factory=list)

    def results(self, task, cells, notify):
        for cell in reversed(cells):
            self.ran.append(cell.seed)
            yield cell, task(cell)


def cells(count=3):
    return [cell_of('quick', 'rigid', seed) for seed in range(count)]


def test_cells_run_once_and_again_only_what_is_not_whole(tmp_path):
    first = CountingExecutor()
    keys = run_cells(cells(), tmp_path, seed_task, executor=first).keys
    assert sorted(first.ran) == [0, 1, 2]
    store = CellStore(tmp_path)
    traces = store.folder / f'{keys[cells()[1]]}.npz'
    traces.write_bytes(traces.read_bytes()[:-20])
    record = store.folder / f'{keys[cells()[2]]}.json'
    record.write_text(record.read_text()[:40])
    second = CountingExecutor()
    run_cells(cells(4), tmp_path, seed_task, executor=second)
    assert sorted(second.ran) == [1, 2, 3]
    for cell in cells(4):
        result = store.load(cell.key())
        assert result.metrics == {'seed': cell.seed}
        np.testing.assert_array_equal(result.traces['series'], float(cell.seed))


def test_cells_that_were_finished_before_an_error_are_kept(tmp_path):
    class Failing(CountingExecutor):

        def results(self, task, cells, notify):
            yield cells[0], task(cells[0])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_cells(cells(), tmp_path, seed_task, executor=Failing())
    later = CountingExecutor()
    run_cells(cells(), tmp_path, seed_task, executor=later)
    assert len(later.ran) == 2


def test_bad_cell_is_refused_before_anything_runs(tmp_path):
    executor = CountingExecutor()
    bad = cell_of('quick', 'rigid', 0, controller={'force': {'damping_rate': -1.0}})
    with pytest.raises(ConfigError, match='damping_rate'):
        run_cells([*cells(), bad], tmp_path, seed_task, executor=executor)
    assert executor.ran == []


def test_lost_cell_is_named_and_run_again_the_next_time(tmp_path):
    class Losing(CountingExecutor):

        def results(self, task, cells, notify):
            for cell in cells:
                yield cell, LostCell('out of memory') if cell.seed == 1 else task(cell)

    run = run_cells(cells(), tmp_path, seed_task, executor=Losing())
    assert run.result(cells()[2]).metrics == {'seed': 2}
    assert run.lost == {cells()[1]: 'out of memory'}
    with pytest.raises(RunError, match='expected a finished cell: out of memory'):
        run.result(cells()[1])
    later = CountingExecutor()
    assert run_cells(cells(), tmp_path, seed_task, executor=later).lost == {}
    assert later.ran == [1]


@pytest.mark.slow
def test_cells_have_the_same_results_with_any_number_of_workers(tmp_path):
    short = [cell_of('step', 'rigid', seed, duration=1.7) for seed in range(3)]
    records = []
    for jobs in (1, 2):
        folder = tmp_path / str(jobs)
        run_cells(short, folder, measure_cell, executor=LocalExecutor(jobs))
        found = [json.loads(path.read_text()) for path in sorted(folder.glob('cells/*.json'))]
        records.append([{**record, 'wall_s': 0.0} for record in found])
    assert len(records[0]) == 3
    assert records[0] == records[1]


def test_finite_leaves_no_number_that_json_has_not():
    assert finite({'a': [float('nan'), 1.0], 'b': (float('inf'), 2)}) == {
        'a': [None, 1.0], 'b': [None, 2]}
