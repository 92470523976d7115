"""
Try the mutations of mutations.md: each changes one line of a copy, and its test must fail then.

``python test/campaign/mutations.py [NUMBER ...]`` prints a line for each and ends with 1 if one
survives. A mutation of a kernel is compiled anew: half a minute each.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
LEFT_OUT = shutil.ignore_patterns('.git', '.venv', 'runs', 'build', '.*_cache', '__pycache__')


def read_mutations() -> list[list[str]]:
    """Return number, file, line before, line after and test of each."""
    rows = [line.split(' | ') for line in (HERE / 'mutations.md').read_text().splitlines()
            if line[:3].strip('| ').isdigit()]
    return [[cell.strip('| `') for cell in row] for row in rows]


def is_caught(folder: Path, file: str, before: str, after: str, test: str) -> bool:
    """Return whether a test fails in a copy of the sources with one change."""
    path = folder / 'multicontact_control' / file
    text = path.read_text()
    if text.count(before) < 1:
        raise SystemExit(f'{file}: expected the line `{before}`, found no such line')
    path.write_text(text.replace(before, after, 1))
    try:
        done = subprocess.run(
            [sys.executable, '-m', 'pytest', '-q', '-x', '-p', 'no:cacheprovider', test],
            cwd=folder, env={**os.environ, 'PYTHONPATH': str(folder),
                             'MULTICONTACT_COMPILE': 'lazily'},
            stdout=subprocess.DEVNULL, check=False)
    finally:
        path.write_text(text)
    return done.returncode == 1


def main() -> None:
    """Try the mutations that are asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__.strip().split('\n')[0])
    parser.add_argument('numbers', nargs='*', metavar='NUMBER', help='which; all if none is given')
    numbers = parser.parse_args().numbers
    survived = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / 'copy'
        shutil.copytree(ROOT, folder, ignore=LEFT_OUT)
        for number, file, before, after, test in read_mutations():
            if numbers and number not in numbers:
                continue
            caught = is_caught(folder, file, before, after, test)
            survived += [] if caught else [number]
            print(f'{number:>2} {file}: {"caught" if caught else "SURVIVED"} ({test})', flush=True)
    sys.exit(f'survived: {", ".join(survived)}' if survived else 0)


if __name__ == '__main__':
    main()
