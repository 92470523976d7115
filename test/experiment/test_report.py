"""A short run in process, read back and reported."""

from dataclasses import replace
import json

from multicontact_control.cli import app
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment import figures, report
from multicontact_control.experiment.figures import run_figures
from multicontact_control.experiment.report import run_claims
from multicontact_control.experiment.results import load_run, load_setup
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.study.presets.compare import matrix
from multicontact_control.experiment.summary import summarise
from multicontact_control.files import write_json
import numpy as np
import pytest
from synthetic_run import disturbance_setup, paper_run, perfect_run
from typer.testing import CliRunner


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Make a run folder with a recording made to the paper."""
    folder = tmp_path_factory.mktemp('run')
    setup = disturbance_setup('puma')
    data = paper_run(setup)
    setup.write(folder / 'config')
    data.save(folder)
    write_json(folder / 'summary.json', summarise(
        data, setup, mode='in_process', timing={'deadline_misses': 0, 'tick_us': {'p50': 1.0}}))
    return folder


def test_load_setup_rebuilds_what_the_run_was_made_with(folder):
    setup, made = load_setup(folder), disturbance_setup('puma')
    assert (setup.plant, setup.noise_estimator) == (made.plant, made.noise_estimator)
    assert setup.scenario == made.scenario
    assert setup.controller == made.controller
    assert (setup.plant_name, setup.seed) == ('puma', 0)
    assert (setup.urdf_dir / setup.controller.robot.urdf).is_file()


def test_load_says_what_is_missing(folder, tmp_path):
    with pytest.raises(ConfigError, match='a folder of `multicontact run` or `simulate`'):
        load_run(tmp_path)
    disturbance_setup().write(tmp_path / 'config')
    write_json(tmp_path / 'summary.json', {'plant': 'rigid', 'seed': 0})
    with pytest.raises(RunError, match='samples.npz'):
        load_run(tmp_path)
    write_json(tmp_path / 'summary.json', {'schema': 1})
    with pytest.raises(ConfigError, match='the summary of a run'):
        load_run(tmp_path)


def test_report_claims_are_those_of_the_recording(folder):
    verdicts = {claim.claim: claim.holds for claim in run_claims(load_run(folder))}
    assert verdicts['The noise variance is about 0.6 N² at rest'] is True
    assert None in verdicts.values()


def test_report_command_writes_a_page_and_figures(folder, tmp_path):
    result = CliRunner().invoke(app, ['report', str(folder), '--out', str(tmp_path)])
    assert result.exit_code == 0, result.output
    text = (tmp_path / 'report.html').read_text(encoding='utf-8')
    for words in ('Claims of the paper', 'Fig. 3', 'Fig. 4', 'Fig. 5', 'Fig. 6', 'Timing',
                  'rigid drives a fixed R is not unstable', 'damping_rate: 100.0'):
        assert words in text
    names = {path.name for path in (tmp_path / 'figures').iterdir()}
    assert {name.rsplit('.')[0] for name in names} == {
        'fig3_force_table', 'fig4_force_board', 'fig5_motion', 'fig6_noise_variance'}
    assert len(names) == 8


def test_runs_of_one_name_have_figures_of_their_own(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(report, 'FORMATS', ('png',))
    runs = [load_run(folder)._replace(folder=tmp_path / name / 'first') for name in 'ab']
    paths = report.write_report(runs, tmp_path / 'out')[1:]
    assert len(paths) == len(set(paths)) == 9
    assert {path.parent for path in paths[:-1]} == {
        tmp_path / 'out' / 'figures' / name / 'first' for name in 'ab'}
    assert all(path.is_file() for path in paths)


def test_axes_of_a_force_show_all_of_it():
    """Of a couple, too, which may be asked for with either sign; on page and paper alike."""
    edge = resolve('edge', plant='rigid')
    data = perfect_run(edge)
    data.alpha_des[:, 1] = data.alpha_true[:, 1] = -20.0
    data.alpha_true[100, 0] = 90.0
    data.alpha_meas[200, 1] = np.nan
    for drawn in run_figures(data, edge)[:2]:
        for panel in (*drawn.panels, drawn.page):
            low, high = panel.limits
            for trace in panel.traces:
                assert low < np.nanmin(trace.values) and np.nanmax(trace.values) < high


@pytest.mark.parametrize('by_topic', [False, True])
def test_every_contact_is_in_the_last_step_side_by_side(tmp_path, monkeypatch, by_topic):
    kept = []
    monkeypatch.setattr(figures.Figure, 'savefig', lambda sheet, *_, **__: kept.append(sheet))
    plane = replace(resolve('plane', plant='rigid', duration=9.0), commanded_by_topic=by_topic)
    data = perfect_run(plane)
    data.alpha_true[:] = data.alpha_des[:] = data.command[:] = plane.commanded(data.time)
    figures.draw_side_by_side([('one', data, plane)], tmp_path / 'x.png')
    axes = kept[0].axes[3]
    lines = {line.get_label(): line for line in axes.lines}
    assert [*lines] == ['face, true', 'face/along, true', 'face/across, true', 'commanded']
    assert len({line.get_color() for line in axes.lines}) == 4
    forces = lines['face/across, true'].get_ydata()
    assert (forces[0], forces[-1]) == (-3.0, 0.0)


@pytest.mark.parametrize('arguments', [
    ['report', 'nowhere'], ['compare', '--estimators', 'nothing'], ['compare', '--plants', 'ur5'],
    ['map', '--jobs', '-1']])
def test_command_with_bad_input_ends_with_2_and_one_line(tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert len(result.output.strip().splitlines()) == 1
    assert result.output.startswith('multicontact: ')


@pytest.mark.slow
def test_compare_command_writes_table_and_page_and_resumes(tmp_path, monkeypatch):
    monkeypatch.setattr(matrix, 'DAMPING_RATES', (60.0,))  # three are in the tests of the study
    arguments = ['compare', '--quick', '--plants', 'rigid', '--estimators', 'fixed',
                 '--jobs', '1', '--out', str(tmp_path)]
    first = CliRunner().invoke(app, arguments)
    assert first.exit_code == 0, first.output
    assert '3 runs, 0 of them finished before' in first.output
    assert 'will take about' in first.output.replace('\n', ' ')
    content = (tmp_path / 'comparison.json').read_bytes()
    again = CliRunner().invoke(app, arguments)
    assert '3 runs, 3 of them finished before' in again.output
    assert (tmp_path / 'comparison.json').read_bytes() == content
    rows = json.loads(content)['rows']
    assert rows[0]['stable'] and rows[0]['label'] == 'fixed'
    text = (tmp_path / 'comparison.html').read_text(encoding='utf-8')
    assert all(row['key'] in text for row in rows)
