"""Threads, scheduling and the cache of what is compiled."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

from multicontact_control.compiled import sources_stamp
from multicontact_control.process import claim_processor, limit_threads, THREAD_VARIABLES
import pytest

ROOT = Path(__file__).parents[1]


def test_threads_are_limited_unless_the_user_says_otherwise(monkeypatch):
    for name in THREAD_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv('OMP_NUM_THREADS', '3')
    limit_threads()
    assert os.environ['OPENBLAS_NUM_THREADS'] == '1'
    assert os.environ['OMP_NUM_THREADS'] == '3'


def test_command_line_does_not_load_numpy_before_that():
    code = 'import sys, multicontact_control.cli; print("numpy" in sys.modules)'
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == 'False'


def test_processor_that_is_not_there_gives_one_clear_line():
    assert claim_processor() == []
    (problem,) = claim_processor(cpus=(4095,))
    assert 'CPU affinity [4095]' in problem and '\n' not in problem


def test_missing_permission_gives_one_clear_line(monkeypatch):
    def refuse(*_arguments):
        raise PermissionError(1, 'Operation not permitted')
    monkeypatch.setattr(os, 'sched_setscheduler', refuse)
    (problem,) = claim_processor(fifo_priority=50)
    assert 'SCHED_FIFO 50 is not permitted' in problem and '\n' not in problem


def test_stamp_is_that_of_compiled_sources_only(tmp_path):
    (tmp_path / 'plain.py').write_text('x = 1')
    (tmp_path / 'kernels.py').write_text('@compiled\ndef f(): pass')
    before = sources_stamp(tmp_path)
    (tmp_path / 'plain.py').write_text('x = 2')
    assert sources_stamp(tmp_path) == before
    (tmp_path / 'kernels.py').write_text('@compiled\ndef f(): return 1')
    assert sources_stamp(tmp_path) != before


CALLER = (
    'from multicontact_control.compiled import compiled\n'
    'from multicontact_control.inner import inner\n'
    '@compiled\ndef outer(x):\n    return inner(x)\n')
INNER = (
    'from multicontact_control.compiled import compiled\n'
    '@compiled\ndef inner(x):\n    return x + {}\n')
RUN = (
    'from multicontact_control.outer import outer\n'
    'print(outer(1.0), sum(outer.stats.cache_hits.values()))')


def package_with_two_kernels(folder, number):
    package = folder / 'multicontact_control'
    if not package.exists():
        package.mkdir()
        for name in ('__init__.py', 'compiled.py'):
            shutil.copy(ROOT / 'multicontact_control' / name, package)
        (package / 'outer.py').write_text(CALLER)
    (package / 'inner.py').write_text(INNER.format(number))
    return package


def run(folder, **environment):
    done = subprocess.run(
        [sys.executable, '-c', RUN], cwd=folder, capture_output=True, text=True, check=True,
        env={**os.environ, 'PYTHONPATH': str(folder), **environment})
    value, hits = done.stdout.split()
    return float(value), int(hits)


def test_change_of_a_called_function_compiles_its_callers_anew(tmp_path):
    package_with_two_kernels(tmp_path, 1.0)
    assert run(tmp_path) == (2.0, 0)
    assert run(tmp_path) == (2.0, 1)
    package_with_two_kernels(tmp_path, 5.0)
    assert run(tmp_path) == (6.0, 0)


@pytest.mark.parametrize('variable', ['NUMBA_CACHE_DIR', 'HOME'])
def test_installation_that_cannot_be_written_is_compiled_once(tmp_path, variable):
    """Find that numba keeps the result in the user's folder, or where it is told to."""
    if os.geteuid() == 0:
        # Root may write everywhere: a file where the folder would be has the same effect.
        (package_with_two_kernels(tmp_path, 1.0) / '__pycache__').write_text('')
    else:
        package_with_two_kernels(tmp_path, 1.0).chmod(0o555)
    cache = tmp_path / 'cache'
    cache.mkdir()
    environment = {variable: str(cache), 'XDG_CACHE_HOME': str(cache)}
    assert run(tmp_path, **environment) == (2.0, 0)
    assert run(tmp_path, **environment) == (2.0, 1)
    assert any(cache.rglob('*.nbi'))
