"""The command line: exit codes, one line per error, help."""

import os
import re
import subprocess
import sys

from multicontact_control import __version__
from multicontact_control.cli.application import app
import pytest
from ros_graph import ROOT
import typer


@pytest.mark.parametrize(('arguments', 'message'), [
    (('simulate', '--scenario', 'papper'), 'scenario: expected one of'),
    (('simulate', '--plant', 'x'), "plant: expected one of rigid, puma, or a path, found 'x'"),
    (('push-test', '--fault', 'x'), "fault: expected one of none, sign, rotate, scale, found 'x'"),
    (('view', 'nowhere'), 'recording: expected a folder of `multicontact run` or `simulate`'),
    (('view', '.'), 'recording: expected bag/*.mcap or samples.npz in it, found .'),
    (('view', 'x', '--seed', '1'), '--seed: expected nothing with a recording'),
    (('run', '--commanded', '--set', 'scenario.duration=20'),
     '--set scenario.duration: expected nothing with --commanded'),
    (('run', '--namespace', '1st'), 'namespace: expected names of letters, digits and _'),
    (('run', '--external'), '--controller: expected the parameter file of your controller'),
    (('run', '--external', '--plant', 'rigid'), '--plant: expected nothing with --external'),
    (('run', '--controller', 'x'), '--controller: expected nothing with a simulated plant'),
    (('calibrate', '--from-bag', 'x'), '--controller: expected the parameter file'),
    (('calibrate', '--tilt', '30'), '--tilt: expected nothing with a simulated plant'),
    (('calibrate', '--from-bag', 'x', '--external'), '--external: expected nothing with --from-b'),
    (('push-test', '--external', '--fault', 'sign'), '--fault: expected nothing with --external'),
    (('design', 'pi', '--stiffness', '9'), 'stiffness: expected two numbers')])
def test_bad_input_exits_with_two_and_one_line(multicontact, tmp_path, arguments, message):
    done = multicontact(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr and done.stderr.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_help_has_units_of_all_commands(multicontact):
    """Brackets are no markup: `Length of the run [s]` was shown without its unit."""
    root = typer.main.get_command(app)
    shown = 0
    for name, command in root.commands.items():
        help_of = multicontact(name, '--help')
        assert help_of.returncode == 0 and 'Usage: multicontact' in help_of.stdout
        texts = [command.help or '', *(getattr(parameter, 'help', None) or ''
                                       for parameter in command.params)]
        units = re.findall(r'\[\w[^]]*\]', ' '.join(texts))
        assert all(help_of.stdout.count(unit) >= units.count(unit) for unit in units), name
        shown += len(units)
    assert shown > 5


def test_process_ends_as_the_application_does(multicontact, tmp_path):
    for arguments in (('--version',), ('simulate', '--plant', 'x')):
        here = multicontact(*arguments)
        there = subprocess.run(
            [sys.executable, '-m', 'multicontact_control.cli', *arguments], cwd=tmp_path,
            env={**os.environ, 'PYTHONPATH': str(ROOT)}, capture_output=True, text=True)
        assert (there.returncode, there.stdout, there.stderr) == (
            here.returncode, here.stdout, here.stderr)
    assert multicontact('--version').stdout.strip() == f'multicontact {__version__}'


def test_start_without_a_command_lists_commands_that_there_are(multicontact):
    done = multicontact()
    assert (done.returncode, done.stderr) == (0, '')
    tried = re.findall(r'^  multicontact ([\w-]+)', done.stdout, re.MULTILINE)
    assert len(tried) >= 4 and set(tried) <= set(typer.main.get_command(app).commands)


@pytest.mark.parametrize(('command', 'option', 'value'), [
    ('view', '--preset', 'paper'), ('view', '--set', 'x=1'), ('report', '--namespace', 'left')])
def test_options_that_a_run_knows_itself_are_refused(
        multicontact, tmp_path, command, option, value):
    (tmp_path / 'config').mkdir()
    (tmp_path / 'summary.json').write_text('{}')
    done = multicontact(command, str(tmp_path), option, value)
    assert done.returncode == 2
    assert f'{option}: expected nothing with ' in done.stderr and done.stderr.count('\n') == 1
