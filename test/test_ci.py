"""What .ci/run finds before it tests."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
STARTS, FAILS = '#!/bin/sh\nexit 0\n', '#!/bin/sh\nexit 1\n'


def program(path, text):
    path.write_text(text, encoding='utf-8')
    path.chmod(0o755)


@pytest.fixture
def machine(tmp_path):
    """Return a folder with all programs that there are, and what looks for a browser on it."""
    for name in ('bash', 'chmod', 'cp', 'dirname', 'env', 'id', 'sh'):
        (tmp_path / name).symlink_to(shutil.which(name))
    program(tmp_path / 'sudo', '#!/bin/sh\nshift\nexec "$@"\n')

    def look():
        return subprocess.run(
            [ROOT / '.ci' / 'browser'], capture_output=True, text=True, check=False,
            env={'PATH': str(tmp_path), 'PYTHON': sys.executable,
                 'PYTHONPATH': os.pathsep.join([str(ROOT), *filter(None, sys.path)])})

    return tmp_path, look


def test_browser_that_starts_is_found(machine):
    folder, look = machine
    program(folder / 'chromium', STARTS)
    assert look().stdout == f'{folder / "chromium"}\n'


def test_browser_is_installed_where_there_is_none(machine):
    folder, look = machine
    program(folder / 'apt-get', f'#!/bin/sh\n[ "$1" = update ] || {{ echo "{STARTS}" > '
                                f'{folder}/chromium; chmod 755 {folder}/chromium; }}\n')
    assert look().stdout == f'{folder / "chromium"}\n'


@pytest.mark.parametrize(('programs', 'why'), [
    ({}, 'there is no apt-get to install one with'),
    ({'apt-get': FAILS}, 'apt-get could not install the package chromium'),
    ({'apt-get': STARTS, 'chromium': FAILS}, 'the package chromium brought none that starts')])
def test_one_line_says_why_there_is_no_browser(machine, programs, why):
    folder, look = machine
    for name, text in programs.items():
        program(folder / name, text)
    found = look()
    assert (found.returncode, found.stdout) == (1, '')
    assert found.stderr == f'no Chromium found that starts, and {why}\n'
