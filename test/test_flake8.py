"""
ament's flake8, in its own configuration, as in every ROS 2 package.

Of its plugins the two that take longest are left out where another does the same: docstrings,
which `test_pep257.py` looks at with all of these rules, and quotes, at which ruff is quicker.
"""

import gc
import importlib.metadata
import importlib.util
from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = [str(ROOT / name)
           for name in ('multicontact_control', 'sim_bridge', 'test', 'benchmarks', 'docs',
                        'setup.py')]
# A plugin, and the module that does the same.
ELSEWHERE = {'flake8-docstrings': 'ament_pep257', 'flake8-quotes': 'ruff'}


@pytest.fixture
def left_out(monkeypatch):
    """Hide from flake8 the plugins that others stand in for, and collect no garbage meanwhile."""
    names = {plugin for plugin, module in ELSEWHERE.items() if importlib.util.find_spec(module)}
    every = importlib.metadata.distributions
    monkeypatch.setattr(importlib.metadata, 'distributions', lambda: (
        found for found in every() if found.metadata['name'] not in names))
    gc.disable()
    yield names
    gc.enable()


@pytest.mark.flake8
@pytest.mark.linter
def test_flake8(left_out):
    ament_flake8 = pytest.importorskip('ament_flake8.main', reason='ament_flake8 not installed')
    code, errors = ament_flake8.main_with_errors(argv=SOURCES)
    assert code == 0, f'{len(errors)} errors:\n' + '\n'.join(errors)


@pytest.mark.flake8
@pytest.mark.linter
def test_quotes():
    """By the rules of flake8-quotes, as they are set in pyproject.toml."""
    pytest.importorskip('ruff', reason='flake8 looks at the quotes, too')
    done = subprocess.run(
        [sys.executable, '-m', 'ruff', 'check', '--no-cache', '--select', 'Q', *SOURCES],
        cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
