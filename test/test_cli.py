"""The command line: exit codes, one line per error, help."""

import json
import os
from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[1]


def _multicontact(*arguments, cwd=None):
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))
    return subprocess.run(
        [sys.executable, '-m', 'multicontact_control.cli', *arguments], cwd=cwd,
        env={**os.environ, 'PYTHONPATH': path}, capture_output=True, text=True, timeout=120,
        check=False)


def test_simulate_leaves_a_run_folder(tmp_path):
    """Series, summary, figures and the exact configuration."""
    out = tmp_path / 'run'
    done = _multicontact('simulate', '--scenario', 'quick', '--plant', 'rigid', '--duration',
                         '3.0', '--seed', '5', '--out', str(out))
    assert done.returncode == 0, done.stderr
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['schema'] == 1
    assert (summary['scenario'], summary['plant'], summary['seed']) == ('quick', 'rigid', 5)
    assert (summary['mode'], summary['ticks']) == ('in_process', 1500)
    assert len(list((out / 'figures').glob('*.png'))) == 4
    assert 'stable' in done.stdout
    again = _multicontact('simulate', '--scenario', 'quick', '--out', str(out))
    assert again.returncode == 2
    assert again.stderr.count('\n') == 1
    assert '--overwrite' in again.stderr


def test_simulate_that_is_not_stable_exits_with_one(tmp_path):
    """A run that ends before any contact holds no force."""
    done = _multicontact('simulate', '--scenario', 'quick', '--plant', 'rigid', '--duration',
                         '0.2', '--out', str(tmp_path / 'run'))
    assert done.returncode == 1
    assert 'NOT stable' in done.stdout
    assert json.loads((tmp_path / 'run' / 'summary.json').read_text())['stable'] is False


@pytest.mark.parametrize(('arguments', 'message'), [
    (('simulate', '--scenario', 'papper'), 'scenario: expected one of'),
    (('simulate', '--plant', 'x'), "plant: expected one of rigid, puma, or a path, found 'x'"),
    (('calibrate', '--plant', 'x'), "plant: expected one of rigid, puma, or a path, found 'x'"),
    (('push-test', '--fault', 'x'), "fault: expected one of none, sign, rotate, scale, found 'x'"),
    (('run', '--seed', '-3'), 'seed: expected a whole number >= 0, found -3'),
    (('run', '--namespace', '1st'), 'namespace: expected names of letters, digits and _')])
def test_bad_input_exits_with_two_and_one_line(tmp_path, arguments, message):
    """Field, expectation and finding; nothing is left behind."""
    done = _multicontact(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('command', [
    (), ('run',), ('simulate',), ('calibrate',), ('push-test',), ('topics',), ('echo',),
    ('record',), ('compare',), ('map',), ('report',)])
def test_help_teaches(command):
    """Every command explains itself."""
    done = _multicontact(*command, '--help')
    assert done.returncode == 0
    assert 'Usage: multicontact' in done.stdout


def test_version_is_the_packages():
    """One version."""
    from multicontact_control import __version__
    assert _multicontact('--version').stdout.strip() == f'multicontact {__version__}'
