"""The compile step: complete, done once, and seen to be missing."""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys

from multicontact_control.compiled import cache_folder
from multicontact_control.experiment.compilation import ensure_compiled
import pytest

ROOT = Path(__file__).parents[2]
COMMANDS = [
    ('simulate', '--scenario', 'quick', '--duration', '3', '--plant', 'rigid', '--bare',
     '--noise-estimator', 'sage_husa'),
    pytest.param(('run', '--scenario', 'quick', '--duration', '3', '--speed', '0'),
                 marks=pytest.mark.nightly)]


def compiled_files():
    folder = cache_folder()
    return {path.relative_to(folder): path.stat().st_mtime_ns for path in folder.rglob('*.nb[ic]')}


@pytest.mark.slow
@pytest.mark.parametrize('arguments', COMMANDS, ids=' '.join)
def test_commands_and_nodes_compile_nothing_after_the_compile_step(tmp_path, arguments):
    if arguments[0] == 'run':
        pytest.importorskip('rclpy')
    ensure_compiled()
    before = compiled_files()
    done = subprocess.run(
        [sys.executable, '-m', 'multicontact_control.cli', *arguments, '--out', str(tmp_path)],
        capture_output=True, text=True, env={**os.environ, 'PYTHONPATH': os.pathsep.join(
            filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))})
    assert done.returncode == 0, done.stderr
    assert compiled_files() == before
    summary = json.loads((tmp_path / 'summary.json').read_text(encoding='utf-8'))
    assert summary['timing']['kernels_compiled'] == 0
    for counts in tmp_path.glob('logs/*.json'):
        assert json.loads(counts.read_text(encoding='utf-8'))['kernels_compiled'] == 0
