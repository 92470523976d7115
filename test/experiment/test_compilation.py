"""The compile step: complete, and done once."""

import json
import os
import subprocess
import sys

from multicontact_control.compiled import cache_folder
from multicontact_control.experiment.compilation import ensure_compiled
import pytest
from ros_graph import ROOT


@pytest.mark.slow
def test_command_compiles_nothing_after_the_compile_step(tmp_path):
    ensure_compiled()
    before = {path: path.stat().st_mtime_ns for path in cache_folder().rglob('*.nb[ic]')}
    done = subprocess.run(
        [sys.executable, '-m', 'multicontact_control.cli', 'simulate', '--plant', 'rigid',
         '--bare', '--noise-estimator', 'sage_husa', '--scenario', 'quick', '--duration', '3',
         '--out', str(tmp_path)],
        capture_output=True, text=True, env={**os.environ, 'PYTHONPATH': str(ROOT)})
    assert done.returncode == 0, done.stderr
    assert {path: path.stat().st_mtime_ns for path in cache_folder().rglob('*.nb[ic]')} == before
    summary = json.loads((tmp_path / 'summary.json').read_text(encoding='utf-8'))
    assert summary['timing']['kernels_compiled'] == 0
