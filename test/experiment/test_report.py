"""Reports: of a run folder that is read back, and of runs whose texts are their own."""

from html import unescape
import json
import re

from multicontact_control.cli import app
from multicontact_control.errors import RunError
from multicontact_control.experiment import report
from multicontact_control.experiment.claims import evidence_of, STATEMENTS
from multicontact_control.experiment.display import verdict_lines
from multicontact_control.experiment.report import run_claims
from multicontact_control.experiment.results import load_run, LoadedRun, summarise
from multicontact_control.experiment.scenario import resolve
from multicontact_control.files import write_json
import pytest
from runs import run_of, summary_of
from synthetic_run import disturbance_setup, paper_run
from typer.testing import CliRunner

# What the text of every report may name: figures and sections of the paper, its numbers, units
# and definitions, and the limits that its claims are judged by.
PAPER = {'3', '4', '5', '6', '4.2', '5.2', '195', '205', '217', '6000', '0.02', '0.6', '100'}
DEFINITIONS = {'63', '2', '3'}  # % of a step, a factor, s


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


def test_load_names_the_file_that_is_missing(tmp_path):
    disturbance_setup().write(tmp_path / 'config')
    write_json(tmp_path / 'summary.json',
               {'plant': 'rigid', 'seed': 0, 'commanded_by_topic': False})
    with pytest.raises(RunError, match='samples.npz'):
        load_run(tmp_path)


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


def numbers_of(text):
    return set(re.findall(r'(?<![\w.])\d+(?:\.\d+)?(?!\w)', text))


def text_of(page):
    """Return the visible text of a page, and that of the configuration."""
    page = re.sub(r'<(style|script|title).*?</\1>', ' ', page, flags=re.DOTALL)
    unfolded = ' '.join(re.findall(r'<details>.*?</details>', page, flags=re.DOTALL))
    shown = re.sub(r'<details>.*?</details>', ' ', page, flags=re.DOTALL)
    return tuple(unescape(re.sub(r'<[^>]*>', ' ', each)) for each in (shown, unfolded))


def values_in(content):
    """Yield all numbers in JSON values, and those in its texts."""
    if isinstance(content, dict):
        content = [*content.keys(), *content.values()]
    if isinstance(content, list):
        for each in content:
            yield from values_in(each)
    elif isinstance(content, str):
        yield from map(float, numbers_of(content))
    elif content is not None:
        yield abs(float(content))


def rounded(values):
    """Return numbers as a text may have them: in SI units or thousandths, or as a percentage."""
    return {form.format(scale * value) for value in values for scale in (1.0, 100.0, 1000.0)
            for form in ('{:.0f}', '{:.1f}', '{:.2f}', '{:.3f}', '{:.4f}', '{:.5f}', '{:.4g}')}


@pytest.mark.parametrize(('plant', 'estimator', 'forces', 'start', 'stiffness'), [
    ('rigid', 'lead_window', (11.0, 13.0), 3.1, 7300.0),
    ('puma', 'fixed', (17.0, 16.0), 3.7, 6000.0)])
def test_report_has_only_numbers_of_the_run_its_configuration_and_the_paper(
        tmp_path, monkeypatch, plant, estimator, forces, start, stiffness):
    monkeypatch.setattr(report, 'FORMATS', ())
    names = ('table', 'board')
    setup = resolve(
        'quick', plant=plant, seed=71, preset='paper', duration=2.0 * start,
        noise_estimator={'estimator': estimator},
        plant_overrides={'surfaces': {name: {'stiffness': stiffness} for name in names}},
        scenario_overrides={'reference': {
            'force_steps': [{'time': start - 1.6, 'forces': dict(zip(names, forces))}],
            'motion': {'start_time': start, 'blend_time': 1.0}}})
    data, summary = run_of(setup).data, summary_of(setup)
    page = report.write_report([LoadedRun(tmp_path, setup, data, summary)], tmp_path)[0]
    shown, configuration = text_of(page.read_text(encoding='utf-8'))
    numbers = numbers_of(shown + '\n'.join(verdict_lines(summary, 'there')))
    evidence = evidence_of(data, setup, summary)
    ratios = [value / other for contact in evidence['contacts'].values() for value, other in (
        *((rise, evidence['designed_rise_s']) for rise in contact['rises_s']),
        (contact['start_peak_n'], contact['rest_std_n']),
        (contact['moving_rms_n'], contact['moving_command_n']),
        (contact['rest_mean_error_n'], contact['rest_command_n'])) if value]
    own = rounded(values_in([summary, evidence, ratios]))
    left = numbers - own - numbers_of(configuration)
    limits = numbers_of(' '.join(claim.bound for claim in STATEMENTS))
    assert len(numbers) > 40 and left <= PAPER | DEFINITIONS | limits
