"""The command line, in this process, and as users start it."""

import os
import subprocess
import sys

from multicontact_control.cli import app
import pytest
from ros_graph import PATIENCE, ROOT


@pytest.fixture(name='multicontact')
def fixture_multicontact(capsys, monkeypatch):
    """Return what calls `multicontact` with some arguments, here: it takes no start."""
    def run(*arguments, cwd=None):
        with monkeypatch.context() as patch:
            if cwd is not None:
                patch.chdir(cwd)
            capsys.readouterr()
            with pytest.raises(SystemExit) as end:
                app(arguments, prog_name='multicontact')
        return subprocess.CompletedProcess(arguments, end.value.code, *capsys.readouterr())
    return run


@pytest.fixture(name='process')
def fixture_process():
    """Return what runs `multicontact` in a process of its own, and waits for it."""
    def run(*arguments, cwd=None):
        path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))
        return subprocess.run(
            [sys.executable, '-m', 'multicontact_control.cli', *arguments], cwd=cwd,
            env={**os.environ, 'PYTHONPATH': path}, capture_output=True, text=True,
            timeout=PATIENCE, check=False)
    return run
