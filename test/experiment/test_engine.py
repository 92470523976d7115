from dataclasses import dataclass, field
import json
import pickle

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.engine import (
    cell_of,
    CellResult,
    CellStore,
    LocalExecutor,
    prepare_cell_folder,
    run_cells,
)
from multicontact_control.experiment.measure import finite, measure_cell
import numpy as np
import pytest


def seed_task(cell):
    return CellResult({'seed': cell.seed}, {'series': np.full((3, 2), float(cell.seed))}, 0.5)


@dataclass
class CountingExecutor:
    """Runs cells here, last one first, and remembers them."""

    ran: list = field(default_factory=list)

    def results(self, task, cells):
        for cell in reversed(cells):
            self.ran.append(cell.seed)
            yield cell, task(cell)


def cells(count=3):
    return [cell_of('quick', 'rigid', seed) for seed in range(count)]


def test_cell_key_does_not_depend_on_the_order_of_overrides():
    first = cell_of('quick', 'rigid', 0, controller={'force': {
        'damping_rate': 30.0, 'input_delay': 0.002}})
    second = cell_of('quick', 'rigid', 0, controller={'force': {
        'input_delay': 0.002, 'damping_rate': 30.0}})
    assert first == second and hash(first) == hash(second)
    assert first.key() == second.key() == pickle.loads(pickle.dumps(first)).key()


def test_cell_key_changes_with_all_that_changes_the_outcome():
    variants = [
        cell_of('quick', 'rigid', 0), cell_of('quick', 'rigid', 1), cell_of('quick', 'puma', 0),
        cell_of('disturbance', 'rigid', 0), cell_of('quick', 'rigid', 0, duration=5.0),
        cell_of('quick', 'rigid', 0, noise_estimator={'estimator': 'fixed'}),
        cell_of('quick', 'rigid', 0, controller={'force': {'damping_rate': 30.0}}),
        cell_of('quick', 'rigid', 0, plant_overrides={'actuator_delay_ticks': 2})]
    assert len({cell.key() for cell in variants}) == len(variants)


def test_cell_key_is_that_of_the_values_not_of_how_they_were_given():
    given = cell_of('quick', 'rigid', 0, controller={'force': {'damping_rate': 20.0}})
    assert given.key() == cell_of('quick', 'rigid', 0).key()


def test_cells_run_once_and_again_only_what_is_not_whole(tmp_path):
    first = CountingExecutor()
    keys = run_cells(cells(), tmp_path, seed_task, executor=first)
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

        def results(self, task, cells):
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


def test_cell_folder_keeps_strangers_and_drops_cells_only_when_told(tmp_path):
    run_cells(cells(1), tmp_path, seed_task, executor=CountingExecutor())
    prepare_cell_folder(tmp_path, overwrite=False)
    assert CellStore(tmp_path).finished(cells()[0].key())
    prepare_cell_folder(tmp_path, overwrite=True)
    assert not CellStore(tmp_path).finished(cells()[0].key())
    other = tmp_path / 'other'
    other.mkdir()
    (other / 'notes.txt').write_text('mine')
    with pytest.raises(ConfigError, match='other files'):
        prepare_cell_folder(other, overwrite=True)


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
