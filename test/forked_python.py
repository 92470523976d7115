"""Programs in processes that have numba already, which takes longer to load than most take."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
import subprocess
import sys
from types import SimpleNamespace

# Nothing of this package is loaded here: that each program does by itself, from where it is.
SERVER = """
import json, os, sys, tempfile, traceback
import numba

numba.njit(lambda x: x)(1.0)  # which loads what every first compilation does
for line in sys.stdin:
    program, arguments, folder, environment = json.loads(line)
    pipes = [os.pipe(), os.pipe()]
    if not os.fork():
        for number, (_, end) in enumerate(pipes, 1):
            os.dup2(end, number)
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(folder)
        sys.argv[1:] = arguments
        tempfile.tempdir = None  # as the environment says
        code = 0
        try:
            exec(program, {'__name__': '__main__'})
        except BaseException:
            traceback.print_exc()
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    said = []
    for begin, end in pipes:
        os.close(end)
        with open(begin) as file:
            said.append(file.read())
    print(json.dumps([os.waitstatus_to_exitcode(os.wait()[1]), *said]), flush=True)
"""


class ForkedPython:
    """What runs programs, each in a process of its own that is forked from one with numba."""

    def __init__(self) -> None:
        # In a folder that has no package: the first entry of the path, '', is that of a program.
        self._server = subprocess.Popen(
            [sys.executable, '-c', SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True, cwd='/')

    def run(
        self, program: str, *arguments: str, cwd: Path, without: tuple[str, ...] = (),
        **environment: str,
    ) -> SimpleNamespace:
        """Run a program in a folder, which its imports are looked for in first."""
        variables = {name: value for name, value in os.environ.items() if name not in without}
        told = [program, arguments, str(cwd), {**variables, **environment}]
        self._server.stdin.write(f'{json.dumps(told)}\n')
        self._server.stdin.flush()
        code, stdout, stderr = json.loads(self._server.stdout.readline())
        return SimpleNamespace(returncode=code, stdout=stdout, stderr=stderr)

    def close(self) -> None:
        self._server.communicate()


@contextmanager
def forked_python() -> Iterator[ForkedPython]:
    """Have processes with numba for a while."""
    python = ForkedPython()
    try:
        yield python
    finally:
        python.close()
