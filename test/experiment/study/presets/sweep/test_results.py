"""What came of a sweep: its table, medians over the seeds, and the picture of them."""

import json

from multicontact_control.experiment.study.jobs import RunJob
from multicontact_control.experiment.study.page import write_study_page
from multicontact_control.experiment.study.presets.sweep.config import StudyConfig
from multicontact_control.experiment.study.presets.sweep.plan import (
    plan_sweep,
    SweepPlan,
    SweepRun,
)
from multicontact_control.experiment.study.presets.sweep.results import (
    chosen_metrics,
    draw_sweep,
    judged,
    metric_values,
    row_of,
    sweep_listing,
    sweep_table,
)
from multicontact_control.experiment.study.presets.sweep.study import SweepStudy
from multicontact_control.experiment.study.table import write_table
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

WORST = 'contacts.*.step_rise_63_s'


@pytest.fixture(scope='module')
def plan():
    return plan_sweep(StudyConfig.model_validate({
        'name': 'one', 'description': 'What <it> shows', 'scenario': 'step', 'plants': ['rigid'],
        'seeds': 3, 'grid': {'plant.surfaces.*.stiffness': [600.0, 60000.0],
                             'noise_estimator.estimator': ['fixed', 'window']}}))


@pytest.fixture(scope='module')
def table():
    """Return 12 runs, of which the last is not stable."""
    return pa.table({
        'stable': [True] * 11 + [False], 'error': pa.array([None] * 12, pa.string()),
        'contacts.table.step_rise_63_s': [float(i) for i in range(12)],
        'contacts.board.step_rise_63_s': [None, 9.0, *[0.5] * 10],
        'contacts.board.rest.true_error_rms_n': [0.1] * 12})


def test_star_is_the_worst_contact(table):
    np.testing.assert_array_equal(
        metric_values(table, WORST), [0.0, 9.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0,
                                      11.0])
    assert metric_values(table, 'contacts.*.none').size == 0
    assert metric_values(table, 'error').size == 0


def test_metrics_are_those_of_stable_runs(table):
    assert np.flatnonzero(np.isnan(judged(table, WORST))).tolist() == [11]
    assert np.isfinite(judged(table, 'stable')).all()


def test_metrics_are_chosen_or_said_to_be_missing(table):
    assert chosen_metrics(table, ()) == (
        ['stable', WORST, 'contacts.*.rest.true_error_rms_n'], [])
    assert chosen_metrics(table, ('stable', 'speed')) == (['stable'], ['speed'])


def test_lines_are_medians_over_the_seeds(plan, table):
    assert len(sweep_listing(plan, table, ['stable']).lines) == 4
    listing = sweep_listing(plan, table, ['stable', WORST])
    assert [column.head for column in listing.columns] == ['plant', *plan.units, 'stable', WORST]
    assert [column.number for column in listing.columns] == [False, False, False, True, True]
    assert listing.lines[0].cells == ['rigid', '600', 'fixed', '3/3', '2']
    assert listing.lines[3].cells == ['rigid', '6e+04', 'window', '2/3', '9.5']


def test_picture_has_a_line_for_each_value_of_the_second_parameter(plan, table):
    axes = draw_sweep(plan, table, ['stable', WORST]).axes
    assert len(axes) == 2
    share, rise = ({line.get_label(): line.get_ydata().tolist() for line in panel.lines}
                   for panel in axes)
    assert share == {'fixed': [1.0, 1.0], 'window': [1.0, pytest.approx(2.0 / 3.0)]}
    assert rise == {'fixed': [2.0, 7.0], 'window': [4.0, 9.5]}
    assert axes[1].get_xscale() == 'log'
    assert axes[1].get_xlabel() == 'plant.surfaces.*.stiffness [N/m]'


def test_page_stands_alone(plan, table, tmp_path):
    columns = {**{name: table[name] for name in table.column_names},
               'verdict': pa.array(['stable'] * 12)}
    page = SweepStudy(plan).page(pa.table(columns), tmp_path)
    assert page.findings == ['12 runs: 11 stable, 1 not, of which 0 ended early and 0 were held '
                             'by the supervisor']
    paths = write_study_page(page, tmp_path / 'sweep')
    assert [path.name for path in paths] == ['sweep.png', 'sweep.html']
    text = paths[1].read_text()
    assert 'What &lt;it&gt; shows' in text and 'data:image/png;base64,' in text
    assert text.count('<tr') == 5
    assert len(text) < 1e6


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
def three_runs():
    study = StudyConfig(name='one', scenario='step', plants=('rigid',), seeds=(0, 1, 2))
    runs = tuple(SweepRun(seed, {'controller.force.input_delay': 0.006},
                          RunJob('step', 'rigid', seed)) for seed in study.seeds)
    return SweepPlan(study, runs, {'controller.force.input_delay': 's'})


def table_of(three_runs):
    return sweep_table(three_runs, [
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


def test_table_has_a_row_for_every_run_with_types_and_units(three_runs):
    table = table_of(three_runs)
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


def test_table_without_a_single_result_is_still_one(three_runs):
    table = sweep_table(three_runs, [row_of({}, 'no') | {'key': str(i)} for i in range(3)])
    assert table['error'].to_pylist() == ['no'] * 3
    assert table.num_rows == 3


def test_same_table_same_bytes_and_no_half_file(three_runs, tmp_path):
    paths = [tmp_path / name for name in ('a.parquet', 'b.parquet')]
    for path in paths:
        write_table(table_of(three_runs), path)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert sorted(tmp_path.iterdir()) == paths
    assert pq.read_table(paths[0]).equals(table_of(three_runs), check_metadata=True)
