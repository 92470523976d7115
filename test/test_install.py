"""The built wheel, installed where nothing can be written, and nothing compiled yet."""

import json
import os
from pathlib import Path
import shutil
import site
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.ros, pytest.mark.nightly]

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope='module')
def installed(tmp_path_factory):
    """Install the wheel, without its clone, into a venv that has the dependencies of this one."""
    folder = tmp_path_factory.mktemp('wheel')
    source = shutil.copytree(ROOT, folder / 'source', ignore=shutil.ignore_patterns(
        '.*', 'build', '*.egg-info', '__pycache__', 'runs', 'test'))
    venv = folder / 'venv'

    def pip(*arguments):
        subprocess.run([sys.executable, '-m', 'pip', '--quiet', '--disable-pip-version-check',
                        *arguments], check=True, capture_output=True)

    pip('wheel', '--no-deps', '--no-build-isolation', '--wheel-dir', folder, source)
    subprocess.run([sys.executable, '-m', 'venv', '--without-pip', venv], check=True)
    pip('--python', venv / 'bin/python', 'install', '--no-deps', '--no-index', '--no-compile',
        '--ignore-installed', *folder.glob('*.whl'))
    (packages,) = venv.glob('lib/python*/site-packages')
    (packages / 'dependencies.pth').write_text(''.join(
        f'import site; site.addsitedir({path!r})\n' for path in site.getsitepackages()))
    # Root may write everywhere: a file where the folder would be has the same effect.
    (packages / 'multicontact_control/__pycache__').write_text('')
    return venv


def test_installed_commands_compile_once_and_run_from_any_folder(installed, tmp_path):
    environment = {name: value for name, value in os.environ.items() if name not in (
        'PYTHONPATH', 'NUMBA_CACHE_DIR', 'XDG_CACHE_HOME')}
    environment.setdefault('AMENT_PREFIX_PATH', sys.prefix)  # where the messages are
    environment |= {'HOME': str(tmp_path), 'PYTHONDONTWRITEBYTECODE': '1'}
    commands = [subprocess.Popen(
        [installed / 'bin/multicontact', *command, '--scenario', 'quick', '--duration', '3',
         '--out', command[0]], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, env=environment) for command in (['simulate'], ['run', '--speed', '0'])]
    outputs = [command.communicate()[0] for command in commands]
    assert [command.returncode for command in commands] == [0, 0], outputs
    # Of two that begin at once one compiles, before anything else, and the other waits.
    compiled = ['compiling the numerical kernels, once' in text for text in outputs]
    assert sorted(compiled) == [False, True]
    summaries = [json.loads((tmp_path / name / 'summary.json').read_text(encoding='utf-8'))
                 for name in ('simulate', 'run')]
    assert len({summary['trajectory_sha256'] for summary in summaries}) == 1
    for counts in tmp_path.glob('run/logs/*.json'):
        assert json.loads(counts.read_text(encoding='utf-8'))['kernels_compiled'] == 0
