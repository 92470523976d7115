"""What is installed: as setup.py and package.xml promise, as a wheel, and by colcon."""

from importlib.util import find_spec
import json
import os
from pathlib import Path
import runpy
import shutil
import site
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import multicontact_control
from packaging.requirements import Requirement
import pytest
from ros_graph import PATIENCE, ROOT
import setuptools
from test_architecture import imports
import yaml

NAME = 'multicontact_control'
PACKAGES = (NAME, 'sim_bridge')
NODES = {'controller_node', 'noise_estimator_node', 'recorder_node', 'sim_node'}
IMPORT_NAMES = {'pin': 'pinocchio', 'pyyaml': 'yaml', 'mcap-ros2-support': 'mcap_ros2'}
MANIFEST = ElementTree.parse(ROOT / 'package.xml').getroot()


@pytest.fixture(scope='module')
def keywords():
    """Return what setup.py hands to setuptools."""
    received = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(sys, 'argv', ['setup.py'])
        patch.setattr(setuptools, 'setup', lambda **keywords: received.update(keywords))
        runpy.run_path(str(ROOT / 'setup.py'))
    return received


def test_both_packages_are_installed_with_all_files(keywords):
    version = multicontact_control.__version__
    assert keywords['version'] == MANIFEST.findtext('version') == version
    installed = set(keywords['packages'])
    assert {name.split('.')[0] for name in installed} == set(PACKAGES)
    for name in PACKAGES:
        for path in (ROOT / name).rglob('*.py'):
            package = '.'.join(path.parent.relative_to(ROOT).parts)
            assert package in installed, path
    patterns = ('*.py', *keywords['package_data'][NAME])
    for path in (ROOT / NAME).rglob('*'):
        if path.is_file() and '__pycache__' not in path.parts:
            assert any(map(path.match, patterns)), path
    for script in keywords['entry_points']['console_scripts']:
        module, function = script.split(' = ')[1].split(':')
        assert function in Path(find_spec(module).origin).read_text(encoding='utf-8')


def test_citation_has_the_version_and_the_licence_of_the_package(keywords):
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text(encoding='utf-8'))
    assert citation['title'] == NAME
    assert citation['version'] == multicontact_control.__version__
    assert citation['license'] == MANIFEST.findtext('license') == keywords['license']


def test_every_import_is_declared(keywords):
    lines = list(keywords['install_requires'])
    for extra in ('certify', 'dask', 'franka', 'learning', 'mujoco', 'pin', 'view'):
        lines += keywords['extras_require'].get(extra, [])
    declared = {element.text for element in MANIFEST.iter('exec_depend')}
    for line in lines:
        name = Requirement(line).name.lower()
        declared.add(IMPORT_NAMES.get(name, name))
    for module, targets in imports().items():
        outside = {target.partition('.')[0] for target in targets}
        undeclared = outside - {*PACKAGES, *declared} - sys.stdlib_module_names
        assert undeclared == set(), module


@pytest.mark.ros
@pytest.mark.nightly
def test_installed_commands_compile_once_and_run_from_any_folder(tmp_path):
    """From the wheel, without its clone, in a venv that has the dependencies of this one."""
    source = tmp_path / 'source'
    venv = tmp_path / 'venv'
    shutil.copytree(
        ROOT,
        source,
        ignore=shutil.ignore_patterns(
            '.*', 'build', '*.egg-info', '__pycache__', 'test'
        ),
    )
    subprocess.run([sys.executable, '-m', 'venv', '--without-pip', venv], check=True)
    (packages,) = venv.glob('lib/python*/site-packages')
    with (packages / 'dependencies.pth').open('w') as file:
        for path in site.getsitepackages():
            file.write(f'import site; site.addsitedir({path!r})\n')
    pip = (sys.executable, '-m', 'pip', '--python', venv / 'bin/python', 'install')
    offline = ('--no-deps', '--no-index', '--no-build-isolation', '--no-compile')
    subprocess.run(
        [*pip, *offline, '--ignore-installed', source], check=True, capture_output=True
    )
    # Root may write everywhere: a file where the folder would be has the same effect.
    (packages / 'multicontact_control/__pycache__').write_text('')
    environment = {**os.environ}
    for name in ('PYTHONPATH', 'NUMBA_CACHE_DIR', 'XDG_CACHE_HOME'):
        environment.pop(name, None)
    environment.setdefault('AMENT_PREFIX_PATH', sys.prefix)  # where the messages are
    environment |= {'HOME': str(tmp_path), 'PYTHONDONTWRITEBYTECODE': '1'}

    def start(command, *options):
        chosen = ('--scenario', 'quick', '--duration', '3', '--out', command)
        return subprocess.Popen(
            [venv / 'bin/multicontact', command, *options, *chosen],
            cwd=source,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=environment,
        )

    def trajectory(command):
        text = (source / command / 'summary.json').read_text(encoding='utf-8')
        return json.loads(text)['trajectory_sha256']

    started = [start('simulate'), start('run', '--speed', '0')]
    outputs = [process.communicate()[0] for process in started]
    assert [process.returncode for process in started] == [0, 0], outputs
    # Of two that begin at once one compiles, before anything else, and the other waits.
    assert 'compiling the numerical kernels, once' in ''.join(outputs)
    assert trajectory('simulate') == trajectory('run')
    for counts in source.glob('run/logs/*.json'):
        assert json.loads(counts.read_text(encoding='utf-8'))['kernels_compiled'] == 0


@pytest.mark.colcon
@pytest.mark.ros
@pytest.mark.nightly
def test_colcon_installs_what_ros2_looks_for(tmp_path):
    for module in ('colcon_core', 'colcon_ros', 'colcon_python_setup_py'):
        pytest.importorskip(module, reason='colcon is not installed')
    (tmp_path / 'src').mkdir()
    (tmp_path / 'src' / NAME).symlink_to(ROOT, target_is_directory=True)
    environment = {**os.environ, 'COLCON_HOME': str(tmp_path / 'home')}
    colcon = (sys.executable, '-c', 'from colcon_core.command import main; main()')

    def run(*command):
        return subprocess.run(
            command,
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )

    built = run(*colcon, 'build', '--event-handlers', 'console_direct+')
    assert built.returncode == 0, built.stdout + built.stderr
    environment.pop('PYTHONPATH', None)
    folder = tmp_path / 'install' / NAME / 'lib' / NAME
    share = tmp_path / 'install' / NAME / 'share'
    commands = {path.name for path in folder.iterdir() if os.access(path, os.X_OK)}
    assert commands == {*NODES, 'franka_bridge', 'multicontact'}
    assert (share / NAME / 'package.xml').is_file()
    assert (share / 'ament_index/resource_index/packages' / NAME).is_file()
    node = f'{folder}/sim_node --ros-args -p no_such:=1'
    done = run('sh', '-c', f'. "{tmp_path}/install/setup.sh" && {node}')
    assert done.returncode == 2, done.stderr
    assert "got unknown 'no_such'" in done.stderr
