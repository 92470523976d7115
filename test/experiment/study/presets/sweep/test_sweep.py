"""Sweeps from the file to the table, its medians and its picture."""

import json

from multicontact_control.experiment import closed_loop
from multicontact_control.experiment.study.presets.sweep.config import plan_sweep, StudyConfig
from multicontact_control.experiment.study.presets.sweep.study import (
    chosen_metrics,
    judged,
    metric_values,
    row_of,
    sweep_listing,
    sweep_study,
    sweep_table,
    SweepStudy,
)
from multicontact_control.experiment.study.study import run_study, StudyOptions
from multicontact_control.experiment.study.table import write_table
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.console import Console
import yaml

WORST = 'contacts.*.step_rise_63_s'
STUDY = {
    'name': 'small', 'scenario': 'step', 'plants': ['rigid'], 'seeds': 2, 'duration': 1.6,
    'grid': {'plant.surfaces.*.stiffness': [600.0, 6.0e5],
             'noise_estimator.estimator': ['fixed']}}


@pytest.fixture(scope='module')
def plan():
    return plan_sweep(StudyConfig.model_validate({
        'name': 'one', 'scenario': 'step', 'plants': ['rigid'], 'seeds': 3, 'grid': {
            'plant.surfaces.*.stiffness': [600.0, 60000.0],
            'noise_estimator.estimator': ['fixed', 'window']}}))


@pytest.fixture(scope='module')
def table():
    """Return 12 runs, of which the last is not stable."""
    return pa.table({
        'stable': [True] * 11 + [False], 'error': pa.array([None] * 12, pa.string()),
        'verdict': ['stable'] * 12,
        'contacts.table.step_rise_63_s': [float(i) for i in range(12)],
        'contacts.board.step_rise_63_s': [None, 9.0, *[0.5] * 10],
        'contacts.board.rest.true_error_rms_n': [0.1] * 12})


def test_star_is_the_worst_contact_of_the_stable_runs(table):
    np.testing.assert_array_equal(metric_values(table, WORST), [0.0, 9.0, *range(2, 12)])
    assert metric_values(table, 'contacts.*.none').size == 0
    assert metric_values(table, 'error').size == 0
    assert np.flatnonzero(np.isnan(judged(table, WORST))).tolist() == [11]
    assert np.isfinite(judged(table, 'stable')).all()
    assert chosen_metrics(table, ()) == (
        ['stable', WORST, 'contacts.*.rest.true_error_rms_n'], [])
    assert chosen_metrics(table, ('stable', 'speed')) == (['stable'], ['speed'])


def test_lines_are_medians_over_the_seeds(plan, table):
    listing = sweep_listing(plan, table, ['stable', WORST])
    assert [column.head for column in listing.columns] == ['plant', *plan.units, 'stable', WORST]
    assert len(listing.lines) == 4
    assert listing.lines[0].cells == ['rigid', '600', 'fixed', '3/3', '2']
    assert listing.lines[3].cells == ['rigid', '6e+04', 'window', '2/3', '9.5']
    page = SweepStudy(plan).page(table, None)
    assert page.findings[0].startswith('12 runs: 11 stable, 1 not')


SUMMARY = {
    'scenario': 'step', 'ticks': 50, 'trajectory_sha256': 'abc', 'timing': {'tick_us': 3.0},
    'contacts': {'table': {'step_rise_63_s': 0.05, 'steps': [{'time_s': 1.0}],
                           'rest': {'true_error_rms_n': None}}},
    'torque': {'max_fraction_of_limit': 1}, 'stable': False,
    'verdict': 'not stable', 'instabilities': ['a: b', 'c'], 'unstable_at_s': 0.5}


def test_table_has_a_row_for_every_run_with_types_and_units(plan, tmp_path):
    rows = [row_of({'summary': None, 'error': 'ZeroDivisionError'}, 'k'),
            *[row_of({'summary': SUMMARY, 'error': None}, 'k')] * 11]
    table = sweep_table(plan, rows)
    assert table.column_names == [
        'run', 'plant', 'seed', 'plant.surfaces.*.stiffness', 'noise_estimator.estimator',
        'stable', 'verdict', 'error', 'instabilities', 'ticks', 'contacts.table.step_rise_63_s',
        'contacts.table.rest.true_error_rms_n', 'torque.max_fraction_of_limit', 'unstable_at_s',
        'trajectory_sha256', 'key']
    units = {field.name: (field.metadata or {}).get(b'unit', b'').decode()
             for field in table.schema}
    assert units['plant.surfaces.*.stiffness'] == 'N/m'
    assert units['contacts.table.step_rise_63_s'] == 's' and units['plant'] == ''
    types = {name: table.schema.field(name).type for name in table.column_names}
    assert types['stable'] == pa.bool_() and types['ticks'] == pa.int64()
    assert types['error'] == pa.string() and types['unstable_at_s'] == pa.float64()
    assert table['ticks'].to_pylist()[:2] == [None, 50]
    assert table['instabilities'].to_pylist()[:2] == [None, 'a: b; c']
    assert json.loads(table.schema.metadata[b'study'])['name'] == 'one'
    paths = [write_table(sweep_table(plan, rows), tmp_path / name)
             for name in ('a.parquet', 'b.parquet')]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert sweep_table(plan, rows[:1] * 12)['error'].to_pylist() == ['ZeroDivisionError'] * 12


@pytest.mark.slow
def test_changed_study_runs_what_is_missing_and_failures_are_rows(tmp_path, monkeypatch):
    study = tmp_path / 'small.yaml'
    real = closed_loop.run_in_process

    def fail(setup, **options):
        if setup.plant.surfaces['table'].stiffness == 6.0e5:
            raise ZeroDivisionError('in the law')
        return real(setup, **options)

    def sweep(seeds):
        study.write_text(yaml.safe_dump({**STUDY, 'seeds': seeds}))
        run_study(sweep_study(str(study)), StudyOptions(tmp_path / 'out', jobs=1),
                  Console(quiet=True))
        return pq.read_table(tmp_path / 'out' / 'sweep.parquet').to_pylist()

    monkeypatch.setattr(closed_loop, 'run_in_process', fail)
    rows = sweep(1)
    assert [row['error'] for row in rows] == [None, 'ZeroDivisionError: in the law']
    assert rows[1]['stable'] is False and rows[1]['torque.max_fraction_of_limit'] is None
    ages = {path: path.stat().st_mtime_ns for path in (tmp_path / 'out').glob('cells/*')}
    rows = sweep(2)
    assert [(row['plant.surfaces.*.stiffness'], row['seed']) for row in rows] == [
        (stiffness, seed) for stiffness in (600.0, 6.0e5) for seed in (0, 1)]
    assert rows[0]['trajectory_sha256'] != rows[1]['trajectory_sha256']
    assert len(list((tmp_path / 'out').glob('cells/*'))) == 4
    assert all(path.stat().st_mtime_ns == age for path, age in ages.items())
    assert {path.name for path in (tmp_path / 'out').iterdir()} == {
        'cells', 'study.yaml', 'sweep.html', 'sweep.parquet', 'sweep.png'}
