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
from test_architecture import imports, is_ros

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
    assert (
        keywords['version']
        == MANIFEST.findtext('version')
        == multicontact_control.__version__
    )
    assert {name.split('.')[0] for name in keywords['packages']} == set(PACKAGES)
    assert {
        path.parent
        for name in PACKAGES
        for path in (ROOT / name).rglob('*.py')
        if not (path.parent / '__init__.py').is_file()
    } == set()
    package = ROOT / 'multicontact_control'
    beside = [
        path.relative_to(package)
        for path in package.rglob('*')
        if path.is_file() and path.suffix != '.py' and '__pycache__' not in path.parts
    ]
    patterns = keywords['package_data']['multicontact_control']
    assert beside and all(any(map(path.match, patterns)) for path in beside)
    for script in keywords['entry_points']['console_scripts']:
        module, function = script.split(' = ')[1].split(':')
        assert function in Path(find_spec(module).origin).read_text(encoding='utf-8')


def test_every_import_is_declared(keywords):
    extras = keywords['extras_require']
    declared = {
        Requirement(line).name.lower()
        for line in sum(
            (extras.get(name, []) for name in ('dask', 'franka', 'mujoco', 'view')),
            keywords['install_requires'],
        )
    }
    outside = (
        {target.split('.')[0] for targets in imports().values() for target in targets}
        - set(PACKAGES)
        - sys.stdlib_module_names
    )
    assert {name for name in outside if not is_ros(name)} <= {
        IMPORT_NAMES.get(name, name) for name in declared
    }
    assert {name for name in outside if is_ros(name)} <= {
        element.text for element in MANIFEST.iter('exec_depend')
    }


@pytest.mark.ros
@pytest.mark.nightly
def test_installed_commands_compile_once_and_run_from_any_folder(tmp_path):
    """From the wheel, without its clone, in a venv that has the dependencies of this one."""
    source, venv = tmp_path / 'source', tmp_path / 'venv'
    shutil.copytree(
        ROOT,
        source,
        ignore=shutil.ignore_patterns(
            '.*', 'build', '*.egg-info', '__pycache__', 'test'
        ),
    )
    subprocess.run([sys.executable, '-m', 'venv', '--without-pip', venv], check=True)
    (packages,) = venv.glob('lib/python*/site-packages')
    (packages / 'dependencies.pth').write_text(
        ''.join(
            f'import site; site.addsitedir({path!r})\n'
            for path in site.getsitepackages()
        )
    )
    subprocess.run(
        [
            sys.executable,
            '-m',
            'pip',
            '--python',
            venv / 'bin/python',
            'install',
            '--no-deps',
            '--no-index',
            '--no-build-isolation',
            '--no-compile',
            '--ignore-installed',
            source,
        ],
        check=True,
        capture_output=True,
    )
    # Root may write everywhere: a file where the folder would be has the same effect.
    (packages / 'multicontact_control/__pycache__').write_text('')
    environment = {
        name: value
        for name, value in os.environ.items()
        if name not in ('PYTHONPATH', 'NUMBA_CACHE_DIR', 'XDG_CACHE_HOME')
    }
    environment.setdefault('AMENT_PREFIX_PATH', sys.prefix)  # where the messages are
    environment |= {'HOME': str(tmp_path), 'PYTHONDONTWRITEBYTECODE': '1'}
    commands = [
        subprocess.Popen(
            [
                venv / 'bin/multicontact',
                *command,
                '--scenario',
                'quick',
                '--duration',
                '3',
                '--out',
                command[0],
            ],
            cwd=source,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=environment,
        )
        for command in (['simulate'], ['run', '--speed', '0'])
    ]
    outputs = [command.communicate()[0] for command in commands]
    assert [command.returncode for command in commands] == [0, 0], outputs
    # Of two that begin at once one compiles, before anything else, and the other waits.
    assert any('compiling the numerical kernels, once' in text for text in outputs)
    summaries = [
        json.loads((source / name / 'summary.json').read_text(encoding='utf-8'))
        for name in ('simulate', 'run')
    ]
    assert len({summary['trajectory_sha256'] for summary in summaries}) == 1
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
    built = subprocess.run(
        [
            sys.executable,
            '-c',
            'from colcon_core.command import main; main()',
            'build',
            '--event-handlers',
            'console_direct+',
        ],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    environment.pop('PYTHONPATH', None)
    folder, share = (
        tmp_path / 'install' / NAME / name for name in (f'lib/{NAME}', 'share')
    )

    assert {path.name for path in folder.iterdir() if os.access(path, os.X_OK)} == {
        *NODES,
        'franka_bridge',
        'multicontact',
    }
    assert (share / NAME / 'package.xml').is_file()
    assert (share / 'ament_index/resource_index/packages' / NAME).is_file()
    command = (
        f'. "{tmp_path}/install/setup.sh" && {folder}/sim_node --ros-args -p no_such:=1'
    )
    done = subprocess.run(
        ['sh', '-c', command],
        cwd=tmp_path,
        env=environment,
        check=False,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert (done.returncode, "got unknown 'no_such'" in done.stderr) == (2, True), (
        done.stderr
    )
