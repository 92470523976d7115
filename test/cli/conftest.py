"""The command line as users start it: in a process of its own."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(name='multicontact')
def fixture_multicontact():
    """Return what runs `multicontact` with some arguments and waits for it."""
    def run(*arguments, cwd=None):
        path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))
        return subprocess.run(
            [sys.executable, '-m', 'multicontact_control.cli', *arguments], cwd=cwd,
            env={**os.environ, 'PYTHONPATH': path}, capture_output=True, text=True, timeout=120,
            check=False)
    return run
