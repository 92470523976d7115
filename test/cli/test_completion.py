"""What the shell completes is what there is, and it does not take long."""

import os
import shutil
import subprocess
import sys
from typing import get_args

from multicontact_control.cli import app, completion
from multicontact_control.config.force import LawName
from multicontact_control.experiment.push_trial import fault_mounting
from multicontact_control.experiment.scenario import law_presets, plant_source
from multicontact_control.experiment.study.presets.robots.study import ENGINES
from multicontact_control.experiment.study.presets.sweep.config import study_path
from multicontact_control.force.laws import LAWS
from multicontact_control.force.noise import ESTIMATORS
import pytest
from ros_graph import PATIENCE, ROOT
from sim_bridge.robots import robot_names
import typer
from typer.main import get_command

HEAVY = ('numba', 'pinocchio', 'pybullet', 'scipy', 'matplotlib', 'rclpy')
LIGHT = f"""
import sys
sys.argv = ['multicontact']
try:
    from multicontact_control.cli.application import main
    main()
finally:
    found = [name for name in {HEAVY!r} if name in sys.modules]
    assert not found, found
"""


def environment(shell, *words):
    line = ' '.join(('multicontact', *words))
    here = {'COMP_WORDS': line, 'COMP_CWORD': str(len(words))} if shell == 'bash' else {
        '_TYPER_COMPLETE_ARGS': line, '_TYPER_COMPLETE_FISH_ACTION': 'get-args'}
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))
    return {**os.environ, **here, 'PYTHONPATH': path,
            '_MULTICONTACT_COMPLETE': f'complete_{shell}'}


@pytest.mark.parametrize(('shell', 'words', 'expected'), [
    ('bash', ('simulate', '--scenario', 'mov'), ['moving_surface']),
    ('zsh', ('run', '--preset', 'laws/p'), ["_arguments '*: :((\"laws/pi\"))'"]),
    ('fish', ('push-test', '--fault', 's'), ['sign', 'scale']),
    ('bash', ('simulate', '--robot', 'panda', '--plant', ''), ['rigid', 'flexible']),
    ('bash', ('view', '--plant', 'ii'), ['iiwa/rigid', 'iiwa/flexible']),
    ('fish', ('compare', '--estimators', 'fixed,inn'), ['fixed,innovation'])])
def test_shells_are_told_the_names_and_nothing_heavy_is_loaded(shell, words, expected):
    done = subprocess.run(
        [sys.executable, '-c', LIGHT], env=environment(shell, *words), capture_output=True,
        text=True, timeout=PATIENCE, check=False)
    assert (done.stdout.split('\n')[:-1], done.stderr) == (expected, '')


def names(found, **given):
    context = typer.Context(get_command(app))
    context.params.update(given)
    return set(found(context))


def test_names_are_those_that_commands_take():
    assert names(completion.laws) == set(LAWS) == set(get_args(LawName))
    assert names(completion.estimators) == set(ESTIMATORS)
    assert names(completion.presets) == set(law_presets())
    assert names(completion.robots) == set(robot_names())
    assert names(completion.native_engines) == set(ENGINES)
    for fault in names(completion.sensor_faults):
        fault_mounting(fault, 0)
    for name in names(completion.studies):
        assert study_path(name).is_file()
    for name in names(completion.plants) - names(completion.plants, robot='kinova'):
        plant_source(name)
    for name in names(completion.plants, robot='kinova'):
        plant_source(name, 'kinova')


@pytest.mark.parametrize('shell', ['bash', 'zsh', 'fish'])
def test_script_for_a_shell_is_one_that_it_can_read(shell):
    done = subprocess.run(
        [sys.executable, '-m', 'multicontact_control.cli', '--show-completion', shell],
        env={**environment(shell), '_MULTICONTACT_COMPLETE': '',
             '_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION': '1'},
        capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr
    assert f'complete_{shell}' in done.stdout
    if shutil.which(shell):
        assert subprocess.run([shell, '-n'], input=done.stdout, text=True).returncode == 0
