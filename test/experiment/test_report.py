"""Reports: of a run folder that is read back, and of runs whose texts are their own."""

import json

from multicontact_control.cli import app
from multicontact_control.experiment import report
from multicontact_control.experiment.report import run_claims
from multicontact_control.experiment.results import load_run, summarise
from multicontact_control.files import write_json
import pytest
from synthetic_run import disturbance_setup, paper_run
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


def test_load_run_rebuilds_what_the_run_was_made_with(folder):
    run, made = load_run(folder), disturbance_setup('puma')
    for part in ('plant', 'noise_estimator', 'scenario', 'controller', 'plant_name', 'seed'):
        assert getattr(run.setup, part) == getattr(made, part)
    assert (run.setup.urdf_dir / run.setup.controller.robot.urdf).is_file()
    assert run.summary == json.loads((folder / 'summary.json').read_text(encoding='utf-8'))
    assert {claim.holds for claim in run_claims(run)} >= {True, None}


def test_report_command_writes_a_page_and_figures(folder, tmp_path):
    result = CliRunner().invoke(app, ['report', str(folder), '--out', str(tmp_path)])
    assert result.exit_code == 0, result.output
    text = (tmp_path / 'report.html').read_text(encoding='utf-8')
    for words in ('Claims of the paper', 'Fig. 3', 'Fig. 4', 'Fig. 5', 'Fig. 6', 'Timing',
                  'damping_rate: 100.0'):
        assert words in text
    assert len(text) < 1e6
    assert sorted(path.name for path in (tmp_path / 'figures').iterdir()) == [
        f'{name}.{ending}' for name in (
            'fig3_force_table', 'fig4_force_board', 'fig5_motion', 'fig6_noise_variance')
        for ending in ('pdf', 'png')]


def test_report_of_two_runs_has_figures_of_both(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(report, 'FORMATS', ('png',))
    runs = [load_run(folder)._replace(folder=tmp_path / name / 'first') for name in 'ab']
    paths = report.write_report(runs, tmp_path / 'out')[1:]
    assert len(paths) == len(set(paths)) == 9 and all(path.is_file() for path in paths)
