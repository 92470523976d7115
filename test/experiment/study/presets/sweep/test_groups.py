"""What a sweep shows: medians over the seeds, and the picture of them."""

from multicontact_control.experiment.study.page import write_study_page
from multicontact_control.experiment.study.presets.sweep.config import StudyConfig
from multicontact_control.experiment.study.presets.sweep.figure import draw_sweep
from multicontact_control.experiment.study.presets.sweep.groups import (
    chosen_metrics,
    groups_of,
    judged,
    metric_values,
    short_names,
    sweep_listing,
)
from multicontact_control.experiment.study.presets.sweep.plan import plan_sweep
from multicontact_control.experiment.study.presets.sweep.study import SweepStudy
import numpy as np
import pyarrow as pa
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
    assert metric_values(table, 'contacts.*.none') is None
    assert metric_values(table, 'error') is None


def test_metrics_are_those_of_stable_runs(table):
    assert np.flatnonzero(np.isnan(judged(table, WORST))).tolist() == [11]
    assert np.isfinite(judged(table, 'stable')).all()


def test_metrics_are_chosen_or_said_to_be_missing(table):
    assert chosen_metrics(table, ()) == (
        ['stable', WORST, 'contacts.*.rest.true_error_rms_n'], [])
    assert chosen_metrics(table, ('stable', 'speed')) == (['stable'], ['speed'])


def test_lines_are_medians_over_the_seeds(plan, table):
    assert [group.rows for group in groups_of(plan)] == [
        (0, 1, 2), (3, 4, 5), (6, 7, 8), (9, 10, 11)]
    listing = sweep_listing(plan, table, ['stable', WORST])
    assert [column.head for column in listing.columns] == ['plant', *plan.units, 'stable', WORST]
    assert [column.number for column in listing.columns] == [False, False, False, True, True]
    assert listing.lines[0].cells == ['rigid', '600', 'fixed', '3/3', '2']
    assert listing.lines[3].cells == ['rigid', '6e+04', 'window', '2/3', '9.5']


def test_short_names_still_tell_columns_apart():
    assert short_names(['plant', 'a.b.c', 'a.d.c', 'e.f']) == ['plant', 'b.c', 'd.c', 'f']


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
