"""The command line, in this process."""

import subprocess

from multicontact_control.cli.application import app
import pytest


@pytest.fixture
def multicontact(capsys, monkeypatch):
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
