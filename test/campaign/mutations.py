"""
Try the mutations of mutations.md: each changes one line of a copy, and its test must fail then.

``python test/campaign/mutations.py [NUMBER ...]`` prints a line for each and ends with 1 if one
survives. A mutation of a kernel is compiled anew: half a minute each.
"""

import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

HERE = Path(__file__).resolve().parent
# Exit codes of pytest.
PASSED = 0
FAILED = 1
LEFT_OUT = shutil.ignore_patterns('.git', '.venv', 'build', '.*_cache', '__pycache__')


def read_mutations():
    """Yield number, file, line before, line after and test of each."""
    for line in (HERE / 'mutations.md').read_text().splitlines():
        if line[:3].strip('| ').isdigit():
            yield [cell.strip('| `') for cell in line.split(' | ')]


def is_caught(folder, file, before, after, test):
    """Return whether a test fails in a copy of the sources with one change."""
    path = folder / 'multicontact_control' / file
    text = path.read_text()
    if before not in text:
        raise SystemExit(f'{file}: expected the line `{before}`, got no such line')
    path.write_text(text.replace(before, after, 1))
    changes = {'PYTHONPATH': str(folder), 'MULTICONTACT_COMPILE': 'lazily'}
    code = subprocess.call(
        [sys.executable, '-m', 'pytest', '-q', '-x', '-p', 'no:cacheprovider', test],
        cwd=folder,
        env={**os.environ, **changes},
        stdout=subprocess.DEVNULL,
    )
    path.write_text(text)
    if code not in (PASSED, FAILED):
        raise SystemExit(f'{test}: pytest ended with {code}: is its environment right?')
    return code == FAILED


if __name__ == '__main__':
    survived = []
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / 'copy'
        shutil.copytree(HERE.parents[1], copy, ignore=LEFT_OUT)
        for number, file, before, after, test in read_mutations():
            if sys.argv[1:] and number not in sys.argv[1:]:
                continue
            outcome = 'caught'
            if not is_caught(copy, file, before, after, test):
                outcome = 'SURVIVED'
                survived.append(number)
            print(number, outcome, file, test, flush=True)
    if survived:
        sys.exit(f'survived: {", ".join(survived)}')
