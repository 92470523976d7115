"""The compile step: complete, done once, and seen to be missing."""

from __future__ import annotations

import json
import os
from pathlib import Path
import shutil
import subprocess
import sys

from forked_python import forked_python
from multicontact_control.compiled import cache_folder
from multicontact_control.experiment import compilation
from multicontact_control.experiment.compilation import ensure_compiled, is_complete
import pytest

ROOT = Path(__file__).parents[2]
COMMANDS = [
    ('simulate', '--scenario', 'quick', '--duration', '3', '--plant', 'rigid', '--bare',
     '--noise-estimator', 'sage_husa'),
    ('run', '--scenario', 'quick', '--duration', '3', '--lockstep'), ('push-test',)]


def compiled_files():
    folder = cache_folder()
    return {path.relative_to(folder): path.stat().st_mtime_ns for path in folder.rglob('*.nb[ic]')}


def command(*arguments, **environment):
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))
    return subprocess.run(
        [sys.executable, '-m', 'multicontact_control.cli', *arguments], capture_output=True,
        text=True, env={**os.environ, 'PYTHONPATH': path, **environment})


@pytest.mark.slow
@pytest.mark.parametrize('arguments', COMMANDS, ids=' '.join)
def test_commands_and_nodes_compile_nothing_after_the_compile_step(tmp_path, arguments):
    if arguments[0] == 'run':
        pytest.importorskip('rclpy')
    ensure_compiled()
    before = compiled_files()
    out = () if arguments[0] == 'push-test' else ('--out', str(tmp_path))
    done = command(*arguments, *out)
    assert done.returncode == 0, done.stderr
    assert compiled_files() == before
    if out:
        summary = json.loads((tmp_path / 'summary.json').read_text(encoding='utf-8'))
        assert summary['timing']['kernels_compiled'] == 0
    for counts in tmp_path.glob('logs/*.json'):
        assert json.loads(counts.read_text(encoding='utf-8'))['kernels_compiled'] == 0


def test_a_folder_that_lost_a_file_or_has_another_fingerprint_is_not_complete(
        tmp_path, monkeypatch):
    (tmp_path / 'sub').mkdir()
    (tmp_path / 'sub' / 'kernel.nbi').write_text('')
    assert not is_complete(tmp_path)
    compilation._complete_file(tmp_path).write_text('{"sub/kernel.nbi": null}')
    assert is_complete(tmp_path)
    monkeypatch.setattr(compilation.llvm, 'get_host_cpu_name', lambda: 'another')
    assert not is_complete(tmp_path)
    monkeypatch.undo()
    (tmp_path / 'sub' / 'kernel.nbi').unlink()
    assert not is_complete(tmp_path)


def test_sources_that_are_changed_and_changed_back_are_compiled_again(tmp_path):
    """Nodes compiled for a minute then, one by one, and nobody had said so."""
    for package in ('multicontact_control', 'sim_bridge'):
        shutil.copytree(ROOT / package, tmp_path / package,
                        ignore=shutil.ignore_patterns('__pycache__'))
    shutil.copytree(ROOT / 'config', tmp_path / 'config')
    shutil.copy(ROOT / 'package.xml', tmp_path)
    program = (
        'from multicontact_control import compiled\n'
        'from multicontact_control.experiment import compilation\n'
        'from multicontact_control.algebra import dot\n'
        'import numpy as np\n'
        # One kernel stands for all.
        'compilation._exercises = lambda: {"one": lambda: dot(*np.eye(3)[:2])}\n'
        'print(compilation.ensure_compiled(), compilation.ensure_compiled())')

    source = tmp_path / 'multicontact_control' / 'algebra.py'
    text = source.read_text()
    with forked_python() as python:
        def compile_it():
            done = python.run(program, cwd=tmp_path)
            assert done.returncode == 0, done.stderr
            return done.stdout.split()

        assert compile_it() == ['1', '0']
        assert compile_it() == ['0', '0']
        source.write_text(f'{text}\n# changed\n')
        assert compile_it() == ['1', '0']
        source.write_text(text)
        assert compile_it() == ['1', '0']
