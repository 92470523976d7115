"""That what setup.py demands exists as wheels, and that the oldest of it works; by uv."""

import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

from packaging.requirements import Requirement
import pytest
from ros_graph import ROOT
from test_packaging import keywords  # noqa: F401 - a fixture

BESIDE_PYTHON = Path(sys.executable).parent
UV = shutil.which('uv') or shutil.which('uv', path=BESIDE_PYTHON)
pytestmark = pytest.mark.nightly
# What a Python has to compile, or cannot have.
SOURCES_ONLY = {'flake8-quotes', 'empy'}
WITHOUT_WHEEL = {
    '3.10': SOURCES_ONLY,
    '3.11': SOURCES_ONLY,
    '3.12': {*SOURCES_ONLY, 'pybullet'},
    '3.13': {*SOURCES_ONLY, 'pybullet', 'pylibfranka'},
}
# What the wheels of ROS leave in the environment of a Python that has loaded them.
OF_THIS_VENV = (
    'AMENT_PREFIX_PATH',
    'LD_LIBRARY_PATH',
    '_ROS_WHEELS_BOOTSTRAP_COMPLETE',
)
LOAD_KNOWN_ARM = """
from multicontact_control.dynamics import known_arm, robot
robot.load_model(known_arm.URDF)
"""


def uv(*arguments):
    """Run uv from a folder without a project."""
    return subprocess.run(
        [UV, *arguments], cwd='/', capture_output=True, text=True, timeout=1200
    )


@pytest.fixture(scope='module')
def registry(tmp_path_factory):
    """Skip where uv is missing, or finds no packages."""
    if UV is None:
        pytest.skip('uv is not installed')
    wanted = tmp_path_factory.mktemp('registry') / 'wanted.txt'
    wanted.write_text('packaging\n')
    asked = uv('pip', 'compile', '--quiet', '--no-cache', wanted)
    if asked.returncode != 0:
        pytest.skip(f'no registry can be reached: {asked.stderr.strip()}')


@pytest.fixture
def venv_python(registry, tmp_path):
    """Return the Python of a new venv without packages."""
    made = uv('venv', '--quiet', '--python', sys.executable, tmp_path / 'venv')
    assert made.returncode == 0, made.stderr
    return tmp_path / 'venv/bin/python'


def install(python, requirements, *options, override=''):
    """Install requirements; an override takes the place of what others ask of that package."""
    wanted = python.parent / 'wanted.txt'
    overrides = python.parent / 'overrides.txt'
    wanted.write_text('\n'.join(requirements))
    overrides.write_text(override)
    files = ('-r', wanted, '--override', overrides)
    installed = uv('pip', 'install', '--quiet', '--python', python, *options, *files)
    assert installed.returncode == 0, installed.stderr


def run_here(python, *arguments, folder):
    """Run a Python of another venv on these sources, with kernels of its own."""
    environment = {
        **os.environ,
        'PATH': f'{python.parent}{os.pathsep}{os.environ["PATH"]}',
        'PYTHONPATH': str(ROOT),
        'NUMBA_CACHE_DIR': str(folder / 'kernels'),
    }
    for name in OF_THIS_VENV:
        environment.pop(name, None)
    return subprocess.run(
        [python, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True
    )


def all_requirements(keywords):  # noqa: F811
    return [
        *keywords['install_requires'],
        *sum(keywords['extras_require'].values(), []),
    ]


@pytest.mark.parametrize('version', WITHOUT_WHEEL)
def test_all_extras_resolve_with_wheels_but_for_those_named(
    registry,
    keywords,  # noqa: F811
    tmp_path,
    version,
):
    def resolve(requirements, left_out):
        never = [f'{name}; python_version < "3"' for name in left_out]
        (tmp_path / 'left_out.txt').write_text('\n'.join(never))
        (tmp_path / 'wanted.txt').write_text('\n'.join(requirements))
        only_wheels = ('--python-version', version, '--only-binary', ':all:')
        files = (tmp_path / 'wanted.txt', '--override', tmp_path / 'left_out.txt')
        return uv('pip', 'compile', *only_wheels, *files)

    resolved = resolve(all_requirements(keywords), WITHOUT_WHEEL[version])
    assert resolved.returncode == 0, resolved.stderr
    for name in WITHOUT_WHEEL[version]:
        alone = resolve([name], [])
        assert 'wheels' in alone.stderr and alone.returncode != 0, name


def test_what_is_newest_resolves_beside_a_native_ros(registry, keywords, tmp_path):  # noqa: F811
    """Ubuntu 24.04 has Python 3.12 and numpy 1.26, and pinocchio for both."""
    wanted = [*keywords['install_requires'], 'numpy==1.26.4']
    (tmp_path / 'wanted.txt').write_text('\n'.join(wanted))
    resolved = uv('pip', 'compile', '--python-version', '3.12', tmp_path / 'wanted.txt')
    assert resolved.returncode == 0, resolved.stderr


def test_core_passes_with_the_lowest_versions(venv_python, keywords, tmp_path):  # noqa: F811
    """The wheels of pinocchio ask for numpy 2, and also work with the numpy of a native ROS."""
    requirements = all_requirements(keywords)
    names = [Requirement(line).name for line in requirements]
    numpy = requirements[names.index('numpy')]
    (lowest,) = re.findall(r'>=([\d.]+)', numpy)
    compiled = (
        'numpy',
        'pybullet',
        'scipy',
        'pandas',
        'numba',
        'llvmlite',
        'matplotlib',
    )
    wheels = [option for name in compiled for option in ('--only-binary', name)]
    options = ('--resolution', 'lowest-direct', *wheels)
    install(venv_python, requirements, *options, override=numpy)
    show_numpy = ('-c', 'import numpy; print(numpy.__version__)')
    found = run_here(venv_python, *show_numpy, folder=tmp_path)
    assert found.stdout.startswith(lowest)
    core = ('-q', '-p', 'no:cacheprovider', '-m', 'not (ros or slow or nightly)')
    done = run_here(venv_python, '-m', 'pytest', *core, folder=tmp_path)
    assert done.returncode == 0, done.stdout[-5000:]


@pytest.mark.parametrize(
    ('pinocchio', 'differences'),
    [('pin==2.7.0', ['M[0, 0]', 'dJ/dt[']), ('pin==3.3.1', [])],
)
def test_a_pinocchio_for_numpy_1_computes_the_known_terms_or_is_refused(
    venv_python,
    keywords,  # noqa: F811
    tmp_path,
    pinocchio,
    differences,
):
    install(venv_python, [*keywords['install_requires'], 'numpy==1.26.4'])
    install(venv_python, [pinocchio], override='numpy==1.26.4')
    done = run_here(venv_python, '-c', LOAD_KNOWN_ARM, folder=tmp_path)
    assert (done.returncode == 0) == (not differences), done.stderr
    for text in differences:
        assert text in done.stderr.splitlines()[-1]
    if differences:
        out = tmp_path / 'run'
        command = ('-m', 'multicontact_control.cli', 'simulate', '--scenario', 'quick')
        refused = run_here(venv_python, *command, '--out', out, folder=tmp_path)
        assert refused.returncode == 1
        assert 'got version 2.7.0' in refused.stderr.splitlines()[-1]
        assert not out.exists()


@pytest.mark.ros
@pytest.mark.parametrize(
    ('version', 'numpy', 'engine'),
    [
        ('3.10', '2.*', 'pybullet'),
        ('3.12', '2.*', 'mujoco'),
        ('3.12', '1.26.4', 'mujoco'),  # as a native ROS 2 Jazzy
        ('3.13', '2.*', 'mujoco'),
    ],
)
def test_graph_runs_on_every_python_with_an_engine_that_has_wheels(
    registry,
    keywords,  # noqa: F811
    tmp_path,
    version,
    numpy,
    engine,
):
    found = uv('python', 'find', '--no-python-downloads', version)
    if found.returncode != 0:
        pytest.skip(f'no Python {version} is installed')
    made = uv('venv', '--quiet', '--python', found.stdout.strip(), tmp_path / 'venv')
    assert made.returncode == 0, made.stderr
    python = tmp_path / 'venv/bin/python'
    wheels = ('--only-binary', 'pybullet', '--only-binary', 'numpy')
    wanted = f'numpy=={numpy}'
    install(python, [*keywords['install_requires'], wanted], *wheels)
    override = '' if '*' in numpy else f'{wanted}\npin==3.3.1'
    install(python, keywords['extras_require']['ros'], override=override)
    out = tmp_path / 'run'
    chosen = ('--scenario', 'quick', '--speed', '0', '--out', out)
    done = run_here(
        python, '-m', 'multicontact_control.cli', 'run', *chosen, folder=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert f'engine: {engine}' in (out / 'config/plant.yaml').read_text()
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['stable']
    assert ('PyBullet is not installed' in done.stderr) == (engine == 'mujoco')
