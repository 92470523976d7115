"""Studies from the file to the table, its lines and its page."""

from functools import partial
import io
import re

from multicontact_control.runs import closed_loop
from multicontact_control.study.config import apply_choices, read_study, StudyConfig
from multicontact_control.study.measure import metrics_row
from multicontact_control.study.presets import make_study
from multicontact_control.study.study import run_study, show_plan
from multicontact_control.study.table import (
    describe_good_runs,
    draw_study,
    list_good_values,
    make_listing,
    terminal_tables,
)
import numpy as np
import pandas as pd
import pytest
from rich.console import Console
import yaml

RISE = 'contacts.*.step_rise_63_s'
STUDY = {
    'name': 'small',
    'scenario': 'step',
    'plants': ['rigid'],
    'seeds': 2,
    'duration': 1.6,
    'factors': {
        'plant.surfaces.*.stiffness': [600.0, 6.0e5],
        'noise_estimator.estimator': ['fixed'],
    },
}
FILES = {
    'cells',
    'study.json',
    'study.csv',
    'study.parquet',
    'study.png',
    'study.pdf',
    'study.html',
}


@pytest.fixture(name='frame')
def fixture_frame():
    """Return two combinations with three seeds, of which the last is not stable."""
    frame = pd.DataFrame(
        {
            'part': '',
            'plant': 'rigid',
            'k': [600.0] * 3 + [6e4] * 3,
            'seed': [0, 1, 2] * 2,
            'stable': [True] * 5 + [False],
            'error': [None] * 6,
            'late': [0.25, np.inf, np.inf, np.nan, 0.125, 0.5],
            'contacts.table.step_rise_63_s': [0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
            'contacts.board.step_rise_63_s': [np.nan, 9.0, 0.5, 0.5, 0.5, 0.5],
            'contacts.board.rest.true_error_rms_n': [0.1] * 6,
        }
    )
    frame.attrs = {'factors': ['part', 'plant', 'k', 'seed'], 'units': {'k': 'N/m'}}
    return frame


def cells_of(frame, **study):
    config = StudyConfig(name='s', scenario='step', **study)
    (shown,) = make_listing(frame, config).values()
    return list(shown), shown.to_numpy().tolist()


def test_lines_are_statistics_over_the_seeds(frame):
    assert cells_of(frame) == (
        ['k [N/m]', 'stable', 'rise [s]', 'rest rms [N]'],
        [['600', '3/3', '2.000', '0.100'], ['60000', '2/3', '4.000', '0.100']],
    )
    columns = [
        {'name': 'n', 'value': 'stable', 'aggregate': 'share'},
        {'name': 'ms', 'value': 'late', 'scale': 1000.0, 'digits': 0},
        {'name': 'most', 'value': RISE, 'aggregate': 'max', 'digits': 1},
        {'name': 'all', 'value': 'contacts.*.step_rise_63_s', 'each': True},
        {'name': 'of a part not chosen', 'value': 'delay', 'aggregate': 'good_values'},
    ]
    assert cells_of(frame, columns=columns)[1] == [
        ['600', '3/3', 'never', '9.0', '1 / 4.75', '-'],
        ['60000', '2/3', '312', '5.0', '4 / 0.5', '-'],
    ]


def draw_two_laws(frame):
    """Draw the frame for two laws, of which the second has no good run at the second value."""
    frames = [frame.assign(law='pi'), frame.assign(law='dob')]
    both = pd.concat(frames, ignore_index=True)
    both.loc[9:, 'stable'] = False
    both.attrs = {'factors': ['part', 'plant', 'k', 'law', 'seed'], 'units': {}}
    return draw_study(both, StudyConfig(name='s', scenario='step'))


def crosses_in(axes):
    return [line for line in axes.lines if line.get_marker() == 'x']


@pytest.mark.parametrize('values', [(600.0, 6e4), ('soft', 'stiff')])
def test_figure_has_a_cross_where_no_run_is_good(frame, values):
    frame['k'] = np.repeat(values, 3)
    figure = draw_two_laws(frame)
    share, rise = figure.axes[:2]
    assert len(crosses_in(rise)) == 1
    assert crosses_in(share) == []
    legend = {text.get_text() for text in figure.legends[0].get_texts()}
    assert legend == {'law = pi', 'law = dob', 'no stable run'}


def test_figure_of_levels_draws_no_point_upon_another(frame):
    frame['k'] = np.repeat(('soft', 'stiff'), 3)
    rise = draw_two_laws(frame).axes[1]
    crosses = crosses_in(rise)
    first, second = (line.get_ydata() for line in rise.lines if line not in crosses)
    assert second[0] - first[0] > 0.2


@pytest.mark.parametrize('width', [30, 80, 400])
@pytest.mark.parametrize('label', ['lead_window', 'window rescaled to the R at rest'])
def test_terminal_shows_every_column_whatever_its_width(width, label):
    row = {'estimator': label, 'k': '600'}
    for i in range(20):
        row[f'value{i} [N]'] = f'{i}.2345'
    row['good'] = 'well ' * 30
    shown = pd.DataFrame([row, row])
    shown.attrs = {'labels': 2}
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(*terminal_tables('compare', {'': shown}, width))
    text = console.export_text()
    words = text.split()
    assert max(map(len, text.splitlines())) <= width
    for i in range(20):
        assert words.count(f'{i}.2345') == 2
        assert re.search(rf'\bvalue{i}\b', text)
    assert text.count('well') == 60
    assert text.count('continued') == text.count('estimator') - 1


@pytest.mark.parametrize(
    ('good', 'values'),
    [
        ((0, 0, 1, 1, 1), '1, 2, 5'),
        ((1, 1, 1, 1, 0), '0.1 to 2'),
        ((0, 0, 0, 0, 0), 'none'),
    ],
)
def test_values_whose_runs_are_all_good_are_listed_or_are_a_range(good, values):
    runs = pd.DataFrame({'k': (0.1, 0.5, 1.0, 2.0, 5.0), 'good': good})
    assert list_good_values(runs.astype({'good': bool}), 'k', 'good') == values


def test_sentences_tell_where_all_runs_are_good(frame):
    frame['law'] = ['pi', 'dob'] * 3
    frame.attrs['factors'] = [*frame.attrs['factors'], 'law']
    config = StudyConfig(name='s', scenario='step', symbols={'k': 'k_s'})
    assert describe_good_runs(frame, config) == [
        'pi is stable on rigid in all runs, with k_s = 600, 60000 N/m.',
        'dob is stable on rigid in 2 of 3 runs, in every run with k_s = 600 N/m.',
    ]


def contact_evidence(rms, lost, recovery):
    """Return what is measured of a contact that is pushed shortly, for long, and in motion."""
    window = {'rms_n': rms, 'lost': lost, 'variance_n2': None}
    short = {'moving': False, 'duration': 0.1, 'peak': 1.0, 'recovery': 0.2}
    lasting = {**short, 'duration': 1.0, 'recovery': recovery}
    in_motion = {**short, 'moving': True, 'recovery': 9.0}
    recoveries = [short, lasting, in_motion]
    return {'rest': window, 'moving': window, 'recoveries': recoveries}


def test_row_has_the_worst_contact_and_infinite_times_of_what_never_came():
    contacts = {
        'a': contact_evidence(0.1, 0.0, 0.3),
        'b': contact_evidence(0.2, None, None),
    }
    evidence = {'unstable_after_motion_s': None, 'contacts': contacts}
    steps = [
        {'rise_63_s': None, 'overshoot_percent': 3.0},
        {'rise_63_s': 0.1, 'overshoot_percent': 1.0},
    ]
    summary = {
        'stable': False,
        'verdict': 'not stable',
        'instabilities': ['a: b', 'c'],
        'ended_early': '',
        'ticks': 50,
        'timing': {'tick_us': 3.0},
        'contacts': {'a': {'rest': {'true_error_rms_n': 0.1}, 'steps': steps}},
    }
    run = {'summary': summary, 'evidence': evidence, 'error': None}
    row = metrics_row({**run, 'final_error_share': 0.05})
    expected = {
        'stable': False,
        'settled': True,
        'instabilities': 'a: b; c',
        'rest_rms_n': 0.2,
        'moving_lost': 0.0,
        'rest_variance_n2': None,
        'push_peak_n': 1.0,
        'short_push_s': 0.2,
        'lasting_push_s': np.inf,
        'push_off_s': np.inf,
        'rise_s': np.inf,
        'overshoot_percent': 3.0,
        'ticks': 50,
        'contacts.a.rest.true_error_rms_n': 0.1,
    }
    assert row == row | expected
    columns = ' '.join(row)
    assert 'timing' not in columns
    assert 'steps' not in columns


def test_row_of_a_run_that_failed_has_its_error_and_is_not_stable():
    row = metrics_row({'summary': None, 'error': 'ZeroDivisionError: x'})
    assert row['error'] == 'ZeroDivisionError: x'
    assert not row['stable']


@pytest.fixture(name='run')
def fixture_run(tmp_path, monkeypatch):
    """Return what runs the study with some seeds, fails at the high stiffness, and shows it."""
    path = tmp_path / 'small.yaml'
    run_in_process = closed_loop.run_in_process

    def fail_when_stiff(setup, **options):
        if setup.plant.surfaces['table'].stiffness == 6.0e5:
            raise ZeroDivisionError('in the law')
        return run_in_process(setup, **options)

    def run(seeds, show=run_study, **options):
        path.write_text(yaml.safe_dump({**STUDY, 'seeds': seeds}))
        study = make_study(apply_choices(read_study(str(path)), {}))
        shown = io.StringIO()
        show(study, tmp_path / 'out', Console(file=shown, width=160), **options)
        return shown.getvalue()

    monkeypatch.setattr(closed_loop, 'run_in_process', fail_when_stiff)
    return run


@pytest.mark.slow
def test_changed_study_runs_what_is_missing_and_failures_are_rows(tmp_path, run):
    out = tmp_path / 'out'
    assert 'seed: 0' in run(1, show_plan)
    assert not out.exists()
    run = partial(run, jobs=1)
    assert '2 jobs, 0 of them finished' in run(1)
    frame = pd.read_parquet(out / 'study.parquet')
    assert frame['error'].fillna('').tolist() == ['', 'ZeroDivisionError: in the law']
    assert frame['stable'].tolist() == [True, False]
    assert frame.attrs['units']['plant.surfaces.*.stiffness'] == 'N/m'
    shown = run(2)
    assert '4 jobs, 2 of them finished' in shown
    assert 'in the law' in shown
    frame = pd.read_parquet(out / 'study.parquet')
    assert len(frame) == 4
    assert frame['trajectory_sha256'].nunique() == 2
    tables = [out / 'study.csv', out / 'study.parquet']
    before = [table.read_bytes() for table in tables]
    assert '4 jobs, 4 of them finished' in run(2)
    assert before == [table.read_bytes() for table in tables]
    assert {path.name for path in out.iterdir()} == FILES
