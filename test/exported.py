"""The C library of a controller, and a program that replays there what ran in Python."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
import subprocess
from typing import Any

from multicontact_control.export.library import export_library
from multicontact_control.export.memory import copy_memory, make_memory_record
from multicontact_control.loop import ControlLoop
from multicontact_control.records import record_dtype
from multicontact_control.supervision import inputs, supervisor
from multicontact_control.tick import ACT, SEE
import numpy as np
import pytest

REPLAY = Path(__file__).with_name('export') / 'replay.c'
STRICT = ('-std=c11', '-Wall', '-Wextra', '-Werror', '-pedantic', '-O2')
TAKE, TICK = range(2)


def export(loop: ControlLoop, folder: Path) -> Path:
    """Export a controller that has seen nothing; return the folder."""
    export_library(loop, folder)
    return folder


def build_replay(folder: Path, *options: str) -> Path:
    """Return the program `replay` beside the library of a folder."""
    program = folder / ''.join(('replay', *options)).replace('=', '-')
    place = ('-I', str(folder), '-L', str(folder))
    subprocess.run(
        ['cc', *STRICT, *options, *place, str(REPLAY), '-o', str(program)]
        + ['-l:libmulticontact_tick.a', '-lm'],
        check=True,
    )
    return program


class Replay:
    """
    What a loop calls from now on goes to the program as well, and is compared there.

    `calls` counts; a difference fails the test with the field in which it is.
    """

    def __init__(self, loop: ControlLoop, command: list[str]) -> None:
        self._loop = loop
        self._dtype = record_dtype(make_memory_record(loop))
        self._memory: Any = np.zeros(1, dtype=self._dtype)
        self.calls = 0
        self._program = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=1 << 20
        )

    def call(self, entry: int, function: Any, arguments: Any) -> Any:
        """Call a function of Python, and send what C needs to do the same."""
        copy_memory(self._loop, self._memory)
        before = self._memory.tobytes()
        result = function(*arguments)
        head = np.array([entry, 1, int(result), entry != TAKE, 0, len(before)])
        self._send(head.tobytes(), before)
        if entry != TAKE:
            copy_memory(self._loop, self._memory)
            self._send(self._memory.tobytes())
        self.calls += 1
        return result

    def _send(self, *parts: bytes) -> None:
        try:
            for part in parts:
                self._program.stdin.write(part)
        except BrokenPipeError:
            self.close()

    def close(self) -> None:
        """End the program; fail if anything was not the same."""
        with_error, _ = self._program.communicate()
        line = with_error.decode().strip()
        if line == f'{self.calls} equal':
            return
        call, _, found = line.partition(' ')
        if found.startswith('byte'):
            found = name_field(self._dtype, int(found.split()[1]))
        pytest.fail(f'call {call} of {self.calls}: {found}')


def name_field(dtype: np.dtype, offset: int) -> str:
    """Return the field of a record that a byte is in."""
    if dtype.subdtype is not None:
        element, _ = dtype.subdtype
        place, rest = divmod(offset, element.itemsize)
        return f'[{place}]{name_field(element, rest)}'
    if dtype.fields is None:
        return ''
    for name, (kind, begin, *_) in dtype.fields.items():
        if begin <= offset < begin + kind.itemsize:
            return f'.{name}{name_field(kind, offset - begin)}'
    return ' between fields'


@contextmanager
def replayed(loop: ControlLoop, *command: Any):
    """Replay by a program what a loop does meanwhile."""
    replay = Replay(loop, list(map(str, command)))
    with pytest.MonkeyPatch.context() as patch:
        for module, name, entry in (
            (inputs, 'check_inputs', TAKE),
            (supervisor, 'tick', TICK),
        ):
            function = getattr(module, name)

            def call(*arguments, function=function, entry=entry):
                if entry == TICK and arguments[0] != SEE | ACT:
                    return function(*arguments)
                return replay.call(entry, function, arguments)

            patch.setattr(module, name, call)
        yield replay
    replay.close()
