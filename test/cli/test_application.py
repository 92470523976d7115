"""The command line: exit codes, one line per error, a run and its folder."""

import json

from multicontact_control import __version__
import pytest


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (('simulate', '--scenario', 'papper'), '--scenario: expected one of'),
        (('simulate', '--duration', '-3'), '--duration: expected 1 to 1e+06 s, got -3'),
        (
            ('simulate', '--set', 'scenario.duration=0.9'),
            'paper.yaml: duration: expected',
        ),
        (
            ('simulate', '--plant', 'x'),
            "--plant: expected one of rigid, puma, or a path, got 'x'",
        ),
        (
            ('view', 'nowhere'),
            'RUN: expected a folder of `multicontact run` or `simulate`',
        ),
        (
            ('report', 'nowhere'),
            'RUN: expected a folder of `multicontact run` or `simulate`',
        ),
        (('report', '.'), 'expected a run, an .mcap file or a folder with one'),
        (
            ('run', '--set', 'controller.patience=0.5'),
            'patience: expected 0, or at least 1 period',
        ),
        (
            ('run', '--set', 'controller.lockstep=false'),
            '--set controller.lockstep: give --free-running',
        ),
        (('view', '.'), 'RUN: expected bag/*.mcap or samples.npz in it, got .'),
        (
            ('run', '--commanded', '--set', 'scenario.duration=20'),
            '--set scenario: leave it out with --commanded',
        ),
        (
            ('run', '--namespace', '1st'),
            '--namespace: expected names of letters, digits and _',
        ),
        (
            ('run', '--external'),
            '--controller: expected the parameter file of your controller',
        ),
        (
            ('run', '--external', '--plant', 'rigid'),
            '--plant: leave it out with --external',
        ),
        (('run', '--controller', 'x'), '--controller: leave it out without --external'),
        (('calibrate', '--from-bag', 'x'), '--controller: expected the parameter file'),
        (
            ('calibrate', '--from-bag', 'x', '--tilt', '30'),
            '--tilt: leave it out with --from-bag',
        ),
        (
            ('design', 'pi', '--stiffness', '9', '1'),
            '--stiffness: expected softest and stiffest',
        ),
        (('export', 'out', '--target', 'pdp11-unknown'), '--target: expected'),
        (
            ('export', 'out', '--controller', 'mine.yaml', '--robot', 'fr3'),
            '--robot: leave it out with --controller',
        ),
    ],
)
def test_bad_input_exits_with_two_and_one_line(
    multicontact, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(tmp_path)
    done = multicontact(*arguments)
    assert done.exit_code == 2
    assert message in done.stderr
    assert done.stderr.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_version_is_that_of_the_package(multicontact):
    assert multicontact('--version').stdout.strip() == f'multicontact {__version__}'


@pytest.mark.parametrize(
    ('command', 'option', 'value'),
    [
        ('view', '--preset', 'paper'),
        ('view', '--set', 'x=1'),
        ('report', '--namespace', 'left'),
    ],
)
def test_options_that_a_run_knows_itself_are_refused(
    multicontact, tmp_path, command, option, value
):
    (tmp_path / 'config').mkdir()
    (tmp_path / 'summary.json').write_text('{}')
    done = multicontact(command, str(tmp_path), option, value)
    assert done.exit_code == 2
    assert f'{option}: leave it out with ' in done.stderr
    assert done.stderr.count('\n') == 1


QUICK = ('--scenario', 'quick', '--plant', 'rigid', '--out', 'run')


@pytest.mark.slow
def test_simulate_leaves_a_run_folder(multicontact, tmp_path, monkeypatch):
    """Series, summary, figures; it is not replaced unless it is asked for."""
    monkeypatch.chdir(tmp_path)
    run = tmp_path / 'run'
    done = multicontact('simulate', *QUICK, '--duration', '3.0', '--seed', '5')
    assert done.exit_code == 0, done.stderr
    assert '\nstable (judged: ' in done.stdout
    summary = json.loads((run / 'summary.json').read_text())
    assert summary['scenario'] == 'quick'
    assert summary['plant'] == 'rigid'
    assert summary['seed'] == 5
    assert summary['mode'] == 'in_process'
    assert summary['ticks'] == 1500
    assert summary['verdict'] == 'stable'
    assert len(list((run / 'figures').glob('*.png'))) == 4
    assert multicontact('report', 'run').exit_code == 0
    refused = multicontact('simulate', *QUICK)
    assert refused.exit_code == 2
    assert '--overwrite' in refused.stderr
    assert refused.stderr.count('\n') == 1
    replaced = multicontact('simulate', *QUICK, '--duration', '1', '--overwrite')
    assert replaced.exit_code == 0
    assert 'not judged: ' in replaced.stdout
    assert not (run / 'report.html').exists()


@pytest.mark.parametrize('text', ['{"sch', '[]', '{}'])
def test_report_refuses_a_summary_that_is_none(multicontact, tmp_path, text):
    (tmp_path / 'config').mkdir()
    (tmp_path / 'summary.json').write_text(text)
    done = multicontact('report', str(tmp_path))
    assert done.exit_code == 2
    assert 'summary.json: expected' in done.stderr
