"""What numba compiles: when, where it is kept, and when it is compiled anew."""

import json
import os
import shutil
import subprocess
import sys

from multicontact_control.runs.compilation import ensure_compiled
import pytest
from ros_graph import ROOT

HEAD = 'from multicontact_control.compiled import compiled\n'
CALLER = HEAD + (
    'from multicontact_control.inner import inner\n@compiled\ndef outer(x): return inner(x)\n'
)
INNER = HEAD + '@compiled\ndef inner(x): return x + {}\n'
OF_CONSTANT = 'from multicontact_control.middle import NUMBER\n' + INNER.format(
    'NUMBER'
)
MIDDLE = 'from multicontact_control import deepest\nNUMBER = 2.0 * deepest.NUMBER\n'
DEEPEST = 'NUMBER = {}\n'
RUN = (
    'from multicontact_control import compiled\n'
    'from multicontact_control.outer import outer\n'
    'print(outer(1.0), compiled.count_compilations())'
)


def write_kernels(folder, number):
    """Write a package with a kernel that calls another, which adds a number."""
    package = folder / 'multicontact_control'
    package.mkdir(exist_ok=True)
    for name in ('__init__.py', 'compiled.py'):
        shutil.copy(ROOT / 'multicontact_control' / name, package)
    (package / 'outer.py').write_text(CALLER)
    (package / 'inner.py').write_text(INNER.format(number))
    return package


def run(folder, **environment):
    """Return the value of the caller, and how many kernels were compiled."""
    variables = {
        name: value for name, value in os.environ.items() if name != 'NUMBA_CACHE_DIR'
    }
    done = subprocess.run(
        [sys.executable, '-c', RUN],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={**variables, 'PYTHONPATH': str(folder), **environment},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_change_of_a_called_function_compiles_its_callers_anew(tmp_path):
    write_kernels(tmp_path, 1.0)
    assert run(tmp_path) == ['2.0', '2']
    assert run(tmp_path) == ['2.0', '0']
    write_kernels(tmp_path, 25.0)  # another size: Python compares size and second
    assert run(tmp_path) == ['26.0', '2']


def test_change_of_an_imported_constant_compiles_what_uses_it_anew(tmp_path):
    """The constant comes from a module without kernels, through another one."""
    package = write_kernels(tmp_path, 0.0)
    (package / 'inner.py').write_text(OF_CONSTANT)
    (package / 'middle.py').write_text(MIDDLE)
    (package / 'deepest.py').write_text(DEEPEST.format(1.0))
    assert run(tmp_path) == ['3.0', '2']
    assert run(tmp_path) == ['3.0', '0']
    (package / 'deepest.py').write_text(DEEPEST.format(12.0))  # another size, as above
    assert run(tmp_path) == ['25.0', '2']


def test_change_of_a_module_without_constants_of_kernels_keeps_them(tmp_path):
    package = write_kernels(tmp_path, 1.0)
    (package / 'apart.py').write_text(DEEPEST.format(1.0))
    assert run(tmp_path) == ['2.0', '2']
    (package / 'apart.py').write_text(DEEPEST.format(12.0))
    assert run(tmp_path) == ['2.0', '0']


def test_installation_that_cannot_be_written_is_compiled_once(tmp_path):
    # Root may write everywhere: a file where the folder would be has the same effect.
    (write_kernels(tmp_path, 1.0) / '__pycache__').write_text('')
    for variable in ('NUMBA_CACHE_DIR', 'XDG_CACHE_HOME'):
        environment = {'XDG_CACHE_HOME': '', variable: str(tmp_path / variable)}
        assert [run(tmp_path, **environment) for _ in range(2)] == [
            ['2.0', '2'],
            ['2.0', '0'],
        ]
        assert any((tmp_path / variable).rglob('*.nbi'))


@pytest.mark.slow
def test_command_compiles_nothing_after_the_compile_step(tmp_path):
    ensure_compiled()
    done = subprocess.run(
        [
            sys.executable,
            '-m',
            'multicontact_control.cli',
            'simulate',
            '--plant',
            'rigid',
            '--bare',
            '--noise-estimator',
            'sage_husa',
            '--scenario',
            'quick',
            '--duration',
            '3',
            '--out',
            str(tmp_path),
        ],
        capture_output=True,
        text=True,
        cwd=tmp_path.parent,
        env={**os.environ, 'PYTHONPATH': str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / 'summary.json').read_text(encoding='utf-8'))
    assert summary['timing']['kernels_compiled'] == 0
