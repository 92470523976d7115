"""The C library of a controller, and a program that replays there what a loop does in Python."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import subprocess
from typing import Any

from multicontact_control.export.library import pack_records
from multicontact_control.export.memory import copy_memory, make_memory_record
from multicontact_control.loop import ControlLoop
from multicontact_control.records import record_dtype
from multicontact_control.supervision import contact_task, inputs, supervisor
from multicontact_control.tick import ACT, SEE
import numpy as np
import pytest

REPLAY = Path(__file__).with_name('export') / 'replay.c'
STRICT = ('-std=c11', '-Wall', '-Wextra', '-Werror', '-pedantic', '-O2')
# The calls of the program.
TAKE, SEEN, ACTED, TICK, FAIL, HOLD, LOCK, RETRY, STOP = range(9)
STAGES = {SEE: SEEN, ACT: ACTED, SEE | ACT: TICK}
# What the caller of the library writes, and `changed`, which a reader of states takes back.
WRITTEN = (
    ('stages', 'sample'),
    ('controls', 'wanted'),
    ('contacts', 'wanted'),
    ('contacts', 'alpha_wanted'),
    ('limits', 'changed'),
    ('motion',),
    ('terms',),
    ('added',),
)


def build_replay(folder: Path, *options: str) -> Path:
    """Return the program `replay` beside the library of a folder."""
    program = folder.parent / f'replay-of-{folder.name}'
    place = ('-I', str(folder), '-L', str(folder))
    subprocess.run(
        ['cc', *STRICT, *options, *place, str(REPLAY), '-o', str(program)]
        + ['-l:libmulticontact_tick.a', '-lm'],
        check=True,
    )
    return program


class Replay:
    """
    What a loop calls from now on goes to a program as well, and is compared there.

    The program has the records of the beginning, and gets what the caller of the library is to
    write; all else it has to find by itself. A difference fails the test and names the field.

    Attributes
    ----------
    calls, refuted
        How many there were, and how often an explanation, which is Python's, has taken a joint's
        velocity for refuted: that is written, too.

    """

    def __init__(self, loop: ControlLoop, command: list[str]) -> None:
        self._loop = loop
        self._dtype = record_dtype(make_memory_record(loop))
        self._memory: Any = np.zeros(1, dtype=self._dtype)
        self._places = [self._find_places(*path) for path in WRITTEN]
        self.calls = 0
        self.refuted = 0
        self._also_written: list[tuple[int, int]] = []
        self._program = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=1 << 20
        )

    def _find_places(self, part: str, field: str = '') -> list[tuple[int, int]]:
        """Return offset and size of a part, or of a field of each of its records."""
        dtype, begin, *_ = self._dtype.fields[part]
        if not field:
            return [(begin, dtype.itemsize)]
        kind, offset, *_ = dtype.base.fields[field]
        places = []
        for k in range(dtype.itemsize // dtype.base.itemsize):
            places.append((begin + k * dtype.base.itemsize + offset, kind.itemsize))
        return places

    def write_refutation(self) -> None:
        """Write what an explanation changes before the next call."""
        self.refuted += 1
        ((begin, _),) = self._find_places('stages', 'state')
        stage = self._dtype['stages'].base
        state = stage.fields['state'][0]
        for name in ('tracks', 'velocities'):
            kind, offset, *_ = state.fields[name]
            self._also_written.append((begin + offset, kind.itemsize))

    def call(
        self, entry: int, argument: int, function: Callable[..., Any], *arguments: Any
    ) -> Any:
        """Call a function of Python, and send what C needs to do the same."""
        copy_memory(self._loop, self._memory)
        before = self._memory.tobytes()
        result = function(*arguments)
        writes = sum(self._places, self._also_written)
        self._also_written = []
        compared = entry != TAKE
        number = int(result or 0)
        head = np.array(
            [entry, argument, len(writes), number, compared], dtype=np.int64
        )
        message = [head.tobytes()]
        for begin, size in writes:
            message += [
                np.array([begin, size]).tobytes(),
                before[begin : begin + size],
            ]
        if compared:
            copy_memory(self._loop, self._memory)
            message.append(self._memory.tobytes())
        try:
            self._program.stdin.write(b''.join(message))
        except BrokenPipeError:
            self.close()
        self.calls += 1
        return result

    def close(self) -> None:
        """End the program; fail if anything was not the same."""
        output, _ = self._program.communicate()
        line = output.decode().strip()
        if line == f'{self.calls} equal':
            return
        call, _, found = line.partition(' ')
        if found.startswith('byte'):
            found = name_field(self._dtype, int(found.split()[1]))
        pytest.fail(f'call {call} of {self.calls}: {found}')


def name_field(dtype: np.dtype, offset: int) -> str:
    """Return the field of a record that a byte is in."""
    if dtype.subdtype is not None:
        place, rest = divmod(offset, dtype.base.itemsize)
        return f'[{place}]{name_field(dtype.base, rest)}'
    for name, (kind, begin, *_) in (dtype.fields or {}).items():
        if begin <= offset < begin + kind.itemsize:
            return f'.{name}{name_field(kind, offset - begin)}'
    return ''


@contextmanager
def replayed(loop: ControlLoop, program: Path, *started_by: str) -> Iterator[Replay]:
    """Replay what a loop does from now on by a program that `build_replay` has made."""
    records = program.with_name(f'records-{os.getpid()}.bin')
    records.write_bytes(pack_records(loop))
    replay = Replay(loop, [*started_by, str(program), str(records)])
    with pytest.MonkeyPatch.context() as patch:

        def watch(owner: Any, name: str, entry_of: Callable[..., tuple[int, int]]):
            function = getattr(owner, name)

            def call(*arguments: Any) -> Any:
                entry, argument = entry_of(*arguments)
                return replay.call(entry, argument, function, *arguments)

            patch.setattr(owner, name, call)

        watch(inputs, 'check_inputs', lambda *_: (TAKE, 0))
        watch(supervisor, 'tick', lambda stages, *_: (STAGES[stages], 0))
        watch(supervisor, 'answer_error', lambda cause, *_: (FAIL, int(cause)))
        watch(supervisor, 'retry', lambda _: (RETRY, 0))
        watch(supervisor, 'stop_control', lambda _: (STOP, 0))
        watch(contact_task, 'hold_task', lambda *given: (HOLD, int(given[-1])))
        watch(contact_task, 'lock_task', lambda *given: (LOCK, int(given[-1])))
        refute = loop.supervisor.inputs.refute_worst_velocity

        def refute_and_write() -> None:
            refute()
            replay.write_refutation()

        patch.setattr(loop.supervisor.inputs, 'refute_worst_velocity', refute_and_write)
        yield replay
    replay.close()
