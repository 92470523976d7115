"""The table of a sweep: its columns, their types and units, its bytes."""

import json

from multicontact_control.experiment.study.jobs import RunJob
from multicontact_control.experiment.study.presets.sweep.config import StudyConfig
from multicontact_control.experiment.study.presets.sweep.plan import SweepPlan, SweepRun
from multicontact_control.experiment.study.presets.sweep.table import row_of, sweep_table
from multicontact_control.experiment.study.table import write_table
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

SUMMARY = {
    'schema': 1, 'scenario': 'step', 'plant': 'rigid', 'mode': 'in_process', 'ticks': 50,
    'rate_hz': 500.0, 'trajectory_sha256': 'abc', 'timing': {'tick_us': 3.0},
    'contacts': {'table': {'step_rise_63_s': 0.05, 'steps': [{'time_s': 1.0}],
                           'rest': {'true_error_rms_n': None}}},
    'torque': {'max_fraction_of_limit': 1}, 'stable': False,
    'verdict': 'not stable', 'instabilities': ['a: b', 'c'], 'unstable_at_s': 0.5,
    'ended_early': None, 'kept_real_time': None, 'claims': [], 'supervised': True,
    'events': [{'time_s': 0.0, 'what': 'none |  | free'}]}


@pytest.fixture
def plan():
    study = StudyConfig(name='one', scenario='step', plants=('rigid',), seeds=(0, 1, 2))
    runs = tuple(SweepRun(seed, 'rigid', seed, {'controller.force.input_delay': 0.006},
                          RunJob('step', 'rigid', seed)) for seed in study.seeds)
    return SweepPlan(study, runs, {'controller.force.input_delay': 's'})


def table_of(plan):
    return sweep_table(plan, [
        row_of({}, 'the worker died') | {'key': 'k0'},
        row_of({'summary': SUMMARY, 'error': 'tick 50: no'}) | {'key': 'k1'},
        row_of({'summary': {**SUMMARY, 'stable': True, 'instabilities': []}, 'error': None})
        | {'key': 'k2'}])


def test_row_is_flat_and_knows_nothing_of_the_machine():
    assert row_of({'summary': SUMMARY, 'error': None}) == {
        'stable': False, 'verdict': 'not stable', 'error': None, 'instabilities': 'a: b; c',
        'unstable_at_s': 0.5, 'ticks': 50, 'rate_hz': 500.0,
        'contacts.table.step_rise_63_s': 0.05, 'contacts.table.rest.true_error_rms_n': None,
        'torque.max_fraction_of_limit': 1, 'trajectory_sha256': 'abc'}


def test_table_has_a_row_for_every_run_with_types_and_units(plan):
    table = table_of(plan)
    units = {field.name: (field.metadata or {}).get(b'unit', b'').decode()
             for field in table.schema}
    assert table.column_names == [
        'run', 'plant', 'seed', 'controller.force.input_delay', 'stable', 'verdict',
        'error', 'instabilities', 'ticks', 'rate_hz', 'contacts.table.step_rise_63_s',
        'contacts.table.rest.true_error_rms_n', 'torque.max_fraction_of_limit', 'unstable_at_s',
        'trajectory_sha256', 'key']
    assert units['controller.force.input_delay'] == units['contacts.table.step_rise_63_s'] == 's'
    assert units['contacts.table.rest.true_error_rms_n'] == 'N'
    assert units['plant'] == ''
    kinds = {name: table.schema.field(name).type for name in table.column_names}
    assert kinds['stable'] == pa.bool_() and kinds['ticks'] == pa.int64()
    assert kinds['error'] == pa.string() and kinds['rate_hz'] == pa.float64()
    assert table['error'].to_pylist() == ['the worker died', 'tick 50: no', None]
    assert table['stable'].to_pylist() == [False, False, True]
    assert table['ticks'].to_pylist() == [None, 50, 50]
    assert json.loads(table.schema.metadata[b'study'])['name'] == 'one'


def test_table_without_a_single_result_is_still_one(plan):
    table = sweep_table(plan, [row_of({}, 'no') | {'key': str(i)} for i in range(3)])
    assert table['error'].to_pylist() == ['no'] * 3
    assert table.num_rows == 3


def test_same_table_same_bytes_and_no_half_file(plan, tmp_path):
    paths = [tmp_path / name for name in ('a.parquet', 'b.parquet')]
    for path in paths:
        write_table(table_of(plan), path)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert sorted(tmp_path.iterdir()) == paths
    assert pq.read_table(paths[0]).equals(table_of(plan), check_metadata=True)
