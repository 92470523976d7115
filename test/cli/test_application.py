"""The command line: exit codes, one line per error, help."""

import re

from multicontact_control import __version__
from multicontact_control.cli.application import app
import pytest
import typer


@pytest.mark.parametrize(('arguments', 'message'), [
    (('simulate', '--scenario', 'papper'), 'scenario: expected one of'),
    (('simulate', '--plant', 'x'), "plant: expected one of rigid, puma, or a path, found 'x'"),
    (('calibrate', '--plant', 'x'), "plant: expected one of rigid, puma, or a path, found 'x'"),
    (('push-test', '--fault', 'x'), "fault: expected one of none, sign, rotate, scale, found 'x'"),
    (('view', '--plant', 'x'), "plant: expected one of rigid, puma, or a path, found 'x'"),
    (('view', 'nowhere'), 'recording: expected a folder of `multicontact run` or `simulate`'),
    (('view', '.'), 'recording: expected bag/*.mcap or samples.npz in it, found .'),
    (('view', 'x', '--seed', '1'), '--seed: expected nothing with a recording, found it'),
    (('view', '--host', '203.0.113.1'), 'host: expected an address of this machine, found'),
    (('view', '--size', '9x9'), 'size: expected WIDTHxHEIGHT of 400 to 8000 pixels'),
    (('run', '--commanded', '--set', 'scenario.duration=20'),
     '--set scenario.duration: expected nothing with --commanded, which plays no scenario'),
    (('run', '--seed', '-3'), 'seed: expected a whole number >= 0, found -3'),
    (('run', '--namespace', '1st'), 'namespace: expected names of letters, digits and _')])
def test_bad_input_exits_with_two_and_one_line(multicontact, tmp_path, arguments, message):
    """Field, expectation and finding; nothing is left behind."""
    done = multicontact(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('command', [
    (), ('run',), ('simulate',), ('calibrate',), ('push-test',), ('topics',), ('echo',),
    ('record',), ('compare',), ('map',), ('report',), ('view',)])
def test_help_teaches(multicontact, command):
    """Every command explains itself."""
    done = multicontact(*command, '--help')
    assert done.returncode == 0
    assert 'Usage: multicontact' in done.stdout


def test_help_says_units(multicontact):
    """Brackets are no markup: `Length of the run [s]` was shown without its unit."""
    texts = {name: [command.help or '', *(getattr(parameter, 'help', None) or ''
                                          for parameter in command.params)]
             for name, command in typer.main.get_command(app).commands.items()}
    for name, told in texts.items():
        units = re.findall(r'\[\w[^]]*\]', ' '.join(told))
        shown = multicontact(name, '--help').stdout
        assert all(shown.count(unit) >= units.count(unit) for unit in units), name
    assert sum('[s]' in text for told in texts.values() for text in told) > 5


def test_process_says_and_ends_as_the_application_does(multicontact, process, tmp_path):
    for arguments in (('--help',), ('--version',), ('simulate', '--plant', 'x')):
        here, there = multicontact(*arguments), process(*arguments, cwd=tmp_path)
        assert (there.returncode, there.stdout, there.stderr) == (
            here.returncode, here.stdout, here.stderr)
    assert list(tmp_path.iterdir()) == []


def test_without_a_command_it_says_what_to_try_first(multicontact):
    done = multicontact()
    assert (done.returncode, done.stderr) == (0, '')
    lines = done.stdout.splitlines()
    assert 5 <= len(lines) <= 7
    tried = [line.split('  ')[1].split()[1:] for line in lines if line.startswith('  ')]
    assert tried == [['view'], ['simulate', '--scenario', 'quick'], ['run'],
                     ['view', 'runs/latest']]
    for command, *_ in tried:
        assert multicontact(command, '--help').returncode == 0


def test_version_is_the_packages(multicontact):
    """One version."""
    assert multicontact('--version').stdout.strip() == f'multicontact {__version__}'


@pytest.mark.parametrize(('command', 'option', 'value'), [
    ('view', '--preset', 'paper'), ('view', '--plant', 'rigid'), ('view', '--set', 'x=1'),
    ('report', '--controller', 'x.yaml'), ('report', '--namespace', 'left')])
def test_what_a_run_knows_itself_is_refused(multicontact, tmp_path, command, option, value):
    """It would have no effect."""
    (tmp_path / 'config').mkdir()
    (tmp_path / 'summary.json').write_text('{}')
    done = multicontact(command, str(tmp_path), option, value)
    assert done.returncode == 2
    assert f'{option}: expected nothing with ' in done.stderr and done.stderr.count('\n') == 1
