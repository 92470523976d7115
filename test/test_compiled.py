"""What numba compiles: when, where it is kept, and when it is compiled anew."""

import os
from pathlib import Path
import shutil

from forked_python import forked_python
from multicontact_control.algebra import dot
from multicontact_control.compiled import bound, sources_stamp
import numpy as np
import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope='module')
def python():
    with forked_python() as started:
        yield started


def test_stamp_is_that_of_compiled_sources_only(tmp_path):
    (tmp_path / 'plain.py').write_text('x = 1')
    (tmp_path / 'kernels.py').write_text('@compiled\ndef f(): pass')
    before = sources_stamp(tmp_path)
    (tmp_path / 'plain.py').write_text('x = 2')
    assert sources_stamp(tmp_path) == before
    (tmp_path / 'kernels.py').write_text('@compiled\ndef f(): return 1')
    assert sources_stamp(tmp_path) != before


def test_bound_kernel_is_compiled_before_its_first_call_and_not_again():
    x, y = np.arange(3.0), np.ones(3)
    fast = bound(dot, x, y)
    compiled = len(dot.signatures)
    assert fast(x, y) == dot(x, y) == 3.0
    with pytest.raises(TypeError):
        fast(x.astype(np.float32), y)
    assert len(dot.signatures) == compiled > 0


def test_function_that_is_not_compiled_is_bound_as_it_is():
    assert bound(sources_stamp, 1.0) is sources_stamp


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


@pytest.fixture
def run(python):
    def start(folder, **environment):
        done = python.run(RUN, cwd=folder, without=('NUMBA_CACHE_DIR',), **environment)
        assert done.returncode == 0, done.stderr
        value, hits = done.stdout.split()
        return float(value), int(hits)
    return start


def test_change_of_a_called_function_compiles_its_callers_anew(run, tmp_path):
    package_with_two_kernels(tmp_path, 1.0)
    assert run(tmp_path) == (2.0, 0)
    assert run(tmp_path) == (2.0, 1)
    package_with_two_kernels(tmp_path, 5.0)
    assert run(tmp_path) == (6.0, 0)


def read_only_package(folder):
    package = package_with_two_kernels(folder, 1.0)
    if os.geteuid() == 0:
        # Root may write everywhere: a file where the folder would be has the same effect.
        (package / '__pycache__').write_text('')
    else:
        package.chmod(0o555)


@pytest.mark.parametrize('variable', ['NUMBA_CACHE_DIR', 'XDG_CACHE_HOME', 'HOME', 'TMPDIR'])
def test_installation_that_cannot_be_written_is_compiled_once(run, tmp_path, variable):
    """Find the result in the user's folder, where one is told, or at last in a temporary one."""
    read_only_package(tmp_path)
    cache, nowhere = tmp_path / 'cache', tmp_path / 'nowhere'
    cache.mkdir()
    nowhere.write_text('')
    environment = {'HOME': str(nowhere), 'XDG_CACHE_HOME': '', variable: str(cache)}
    assert run(tmp_path, **environment) == (2.0, 0)
    assert run(tmp_path, **environment) == (2.0, 1)
    assert any(cache.rglob('*.nbi'))


def test_where_nothing_can_be_written_every_process_compiles(run, tmp_path):
    read_only_package(tmp_path)
    nowhere = tmp_path / 'nowhere'
    nowhere.write_text('')
    environment = {'NUMBA_CACHE_DIR': str(nowhere)}
    assert run(tmp_path, **environment) == (2.0, 0)
    assert run(tmp_path, **environment) == (2.0, 0)


def test_all_that_is_stored_is_taken_before_it_is_called_and_nothing_else(python, tmp_path):
    package_with_two_kernels(tmp_path, 1.0)
    program = (
        'import sys\n'
        'from multicontact_control import compiled\n'
        'from multicontact_control.outer import outer\n'
        'names = sorted(compiled.load_stored())\n'
        'outer(int(sys.argv[1]) if sys.argv[1:] else 1.0)\n'
        'print(",".join(names) or "-", sum(outer.stats.cache_hits.values()), '
        'compiled.compiled_here())')

    def load_and_call(*arguments):
        done = python.run(program, *arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    assert load_and_call() == ['-', '0', '2']
    assert load_and_call() == ['inner,outer', '1', '0']
    assert load_and_call('1') == ['inner,outer', '1', '2']  # of another type
    assert load_and_call('1') == ['inner,inner,outer,outer', '2', '0']
    (tmp_path / 'multicontact_control' / 'inner.py').write_text(INNER.format(5.0))
    assert load_and_call() == ['-', '0', '2']
    for path in (tmp_path / 'multicontact_control' / '__pycache__').rglob('outer*.nbc'):
        path.unlink()  # numba writes the index first
    assert load_and_call() == ['inner', '0', '1']


def test_only_what_is_really_compiled_is_told(python, tmp_path):
    package_with_two_kernels(tmp_path, 1.0)
    program = (
        'from multicontact_control import compiled\n'
        'from multicontact_control.outer import outer\n'
        'told = []\n'
        'with compiled.compilations_told(told.append):\n    outer(1.0)\n'
        'print(",".join(told) or "-", compiled.compiled_here())')

    def compile_and_tell():
        done = python.run(program, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    names = 'multicontact_control.outer.outer,multicontact_control.inner.inner'
    assert compile_and_tell() == [names, '2']
    assert compile_and_tell() == ['-', '0']
