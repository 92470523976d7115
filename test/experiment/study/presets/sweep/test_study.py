"""Sweeps from the file to the table, with any number of workers and on a cluster."""

import csv

from multicontact_control.errors import ConfigError
from multicontact_control.experiment import closed_loop
from multicontact_control.experiment.study.presets.sweep.study import sweep_study
from multicontact_control.experiment.study.study import run_study, StudyOptions
import pyarrow.parquet as pq
import pytest
from rich.console import Console
import yaml

STUDY = {
    'name': 'small', 'scenario': 'step', 'plants': ['rigid'], 'seeds': 2, 'duration': 1.7,
    'grid': {'plant.surfaces.*.stiffness': [600.0, 6000.0, 6.0e5],
             'noise_estimator.estimator': ['fixed']}}


@pytest.fixture
def sweep(tmp_path):
    """Return what runs the small study into a folder and returns what was shown."""
    study = tmp_path / 'small.yaml'

    def run(name, changes=None, **options):
        study.write_text(yaml.safe_dump({**STUDY, **(changes or {})}))
        with (tmp_path / 'terminal.txt').open('w') as file:
            run_study(sweep_study(str(study)), StudyOptions(tmp_path / name, **options),
                      Console(file=file, width=160))
        return (tmp_path / 'terminal.txt').read_text()
    return run


@pytest.mark.slow
def test_table_is_the_same_with_one_worker_and_a_cluster(sweep, tmp_path, dask_cluster):
    for name, options in (('one', {'jobs': 1}), ('dask', {'dask': dask_cluster.address})):
        assert '6 runs' in sweep(name, **options)
    tables = [(tmp_path / name / 'sweep.parquet').read_bytes() for name in ('one', 'dask')]
    assert tables[0] == tables[1]
    rows = pq.read_table(tmp_path / 'one' / 'sweep.parquet').to_pylist()
    assert [(row['plant.surfaces.*.stiffness'], row['seed']) for row in rows] == [
        (stiffness, seed) for stiffness in (600.0, 6000.0, 6.0e5) for seed in (0, 1)]
    assert len({row['trajectory_sha256'] for row in rows}) == 6
    assert not any(name for name in rows[0] if 'wall' in name or 'timing' in name)
    assert {path.name for path in (tmp_path / 'one').iterdir()} == {
        'cells', 'study.yaml', 'sweep.html', 'sweep.parquet', 'sweep.png', 'timings.csv'}
    walls = list(csv.DictReader((tmp_path / 'one' / 'timings.csv').read_text().splitlines()))
    assert [int(line['run']) for line in walls] == list(range(6))
    assert all(float(line['wall_s']) > 0.0 for line in walls)


@pytest.mark.slow
def test_second_start_does_only_what_is_missing(sweep, tmp_path):
    sweep('out', jobs=1)
    kept = tmp_path / 'out' / 'cells'
    ages = {path: path.stat().st_mtime_ns for path in kept.glob('*.json')}
    assert len(ages) == 6
    table = (tmp_path / 'out' / 'sweep.parquet').read_bytes()
    gone = sorted(ages)[2]
    gone.unlink()
    assert '6 runs, 5 of them finished before' in sweep('out', jobs=1)
    for path, age in ages.items():
        assert (path.stat().st_mtime_ns == age) == (path != gone)
    assert (tmp_path / 'out' / 'sweep.parquet').read_bytes() == table
    shown = sweep('out', {'seeds': 3}, jobs=1, dry_run=True)
    assert '9 runs, 6 of them finished before; the other 3' in shown


def test_dry_run_leaves_nothing(sweep, tmp_path):
    shown = sweep('out', dry_run=True)
    assert '3 combinations with 2 seeds' in shown
    assert '6 runs, 0 of them finished before; the other 6 will take about' in shown
    assert 'plant.surfaces.*.stiffness [N/m]: 600.0, 6000.0, 600000.0\n' in shown
    assert not (tmp_path / 'out').exists()


@pytest.mark.slow
def test_run_that_raises_is_a_row(sweep, tmp_path, monkeypatch):
    """Whatever one combination does, the others are run."""
    real = closed_loop.run_in_process

    def fail(setup, **options):
        if setup.plant.surfaces['table'].stiffness == 6.0e5:
            raise ZeroDivisionError('in the law')
        return real(setup, **options)

    monkeypatch.setattr(closed_loop, 'run_in_process', fail)
    shown = sweep('out', jobs=1)
    assert 'of which 2 ended early' in shown
    rows = pq.read_table(tmp_path / 'out' / 'sweep.parquet').to_pylist()
    assert [row['error'] for row in rows] == [None] * 4 + ['ZeroDivisionError: in the law'] * 2
    assert [row['stable'] for row in rows[4:]] == [False, False]
    assert rows[4]['torque.max_fraction_of_limit'] is None


@pytest.mark.slow
def test_run_that_cannot_go_on_is_a_row(sweep, tmp_path):
    """Two contacts at the same point cannot be told apart."""
    point = {'controller.contacts.board.normal_world': [0.0, 0.0, -1.0],
             'controller.contacts.board.point_operational': [0.0, 0.0, 0.24]}
    points = [point, {'controller.force.damping_rate': 20.0}]
    shown = sweep('out', {'supervised': False, 'grid': {}, 'points': points, 'seeds': [4]}, jobs=1)
    assert '2 runs: ' in shown and 'of which 1 ended early' in shown
    rows = pq.read_table(tmp_path / 'out' / 'sweep.parquet').to_pylist()
    assert 'which depend on each other' in rows[0]['error']
    assert rows[0]['controller.contacts.board.normal_world'] == '[0.0,0.0,-1.0]'
    assert rows[1]['error'] is None and rows[1]['ticks'] == 850


def test_jobs_and_dask_are_one_or_the_other(sweep, tmp_path):
    with pytest.raises(ConfigError, match='jobs: expected nothing together with --dask'):
        sweep('out', jobs=2, dask='tcp://127.0.0.1:1')
    assert not (tmp_path / 'out').exists()


def test_folder_with_other_files_is_left_alone(sweep, tmp_path):
    (tmp_path / 'out').mkdir()
    (tmp_path / 'out' / 'notes.txt').write_text('mine')
    with pytest.raises(ConfigError, match='out: expected a new or empty folder'):
        sweep('out')
