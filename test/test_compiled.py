"""What numba compiles: when, where it is kept, and when it is compiled anew."""

import os
from pathlib import Path
import shutil

from forked_python import forked_python
import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope='module')
def python():
    with forked_python() as started:
        yield started


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
    package_with_two_kernels(tmp_path, 25.0)  # another size: Python compares size and second
    assert run(tmp_path) == (26.0, 0)


def read_only_package(folder):
    package = package_with_two_kernels(folder, 1.0)
    if os.geteuid() == 0:
        # Root may write everywhere: a file where the folder would be has the same effect.
        (package / '__pycache__').write_text('')
    else:
        package.chmod(0o555)


@pytest.mark.parametrize('variable', ['NUMBA_CACHE_DIR', 'XDG_CACHE_HOME', 'TMPDIR'])
def test_installation_that_cannot_be_written_is_compiled_once(run, tmp_path, variable):
    read_only_package(tmp_path)
    cache, nowhere = tmp_path / 'cache', tmp_path / 'nowhere'
    cache.mkdir()
    nowhere.write_text('')
    environment = {'HOME': str(nowhere), 'XDG_CACHE_HOME': '', variable: str(cache)}
    assert run(tmp_path, **environment) == (2.0, 0)
    assert run(tmp_path, **environment) == (2.0, 1)
    assert any(cache.rglob('*.nbi'))


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
    (tmp_path / 'multicontact_control' / 'inner.py').write_text(INNER.format(25.0))
    assert load_and_call() == ['-', '0', '2']
