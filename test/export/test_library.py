"""The tick as a C library: what it needs, what it refuses, and that it is the one of Python."""

from pathlib import Path
import re
import subprocess

from exported import build_replay, export, replayed, STRICT
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.export import library
from multicontact_control.export.library import HEADER, RECORDS
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import pytest

QUICK_TICKS = 3000
# Of libm and of C that need nothing else, and take no lock.
HARMLESS = {'memcpy', 'memmove', 'memset'}
MATHEMATICS = {
    'acos',
    'asin',
    'atan2',
    'cos',
    'exp',
    'log',
    'pow',
    'sin',
    'sincos',
    'tan',
    'tanh',
}
pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def quick(tmp_path_factory) -> Path:
    """Return the folder of the library of the controller of `quick`."""
    loop = ClosedLoop(resolve('quick'))
    folder = export(loop.control, tmp_path_factory.mktemp('export') / 'quick')
    loop.close()
    return folder


def undefined_symbols(archive: Path) -> set[str]:
    listed = subprocess.run(
        ['nm', '--undefined-only', archive], capture_output=True, text=True, check=True
    )
    return set(re.findall(r' U (\w+)', listed.stdout))


def test_library_needs_nothing_but_mathematics(quick):
    """So no call within a tick allocates, locks or enters the system."""
    symbols = undefined_symbols(quick / 'libmulticontact_tick.a')
    assert symbols <= HARMLESS | MATHEMATICS


def test_tick_of_quick_is_that_of_python(quick):
    loop = ClosedLoop(resolve('quick'))
    with replayed(loop.control, quick) as replay:
        for _ in range(QUICK_TICKS):
            loop.advance()
    loop.close()
    assert replay.calls > QUICK_TICKS


@pytest.mark.parametrize('options', [['gcc', '-std=c11'], ['g++', '-std=c++17']])
def test_header_compiles_without_a_warning(quick, options, tmp_path):
    program = tmp_path / 'program.cpp'
    program.write_text(f'#include "{HEADER}"\n')
    language = 'c++' if '++' in options[0] else 'c'
    subprocess.run(
        [*options, *STRICT[1:], '-I', quick, '-x', language, '-c', program]
        + ['-o', tmp_path / 'program.o'],
        check=True,
    )


@pytest.mark.parametrize('place, refused', [(0, '1'), (8, '2'), (16, '1'), (None, '1')])
def test_records_of_another_layout_are_refused(quick, tmp_path, place, refused):
    content = bytearray((quick / RECORDS).read_bytes())
    if place is None:
        content.pop()
    else:
        content[place] ^= 1
    records = tmp_path / RECORDS
    records.write_bytes(content)
    done = subprocess.run(
        [build_replay(quick), records], capture_output=True, text=True, input=''
    )
    assert done.stderr == f'records refused: {refused}\n'


def test_export_leaves_a_folder_of_something_else_alone(tmp_path):
    (tmp_path / 'thesis.tex').touch()
    with pytest.raises(ConfigError, match='that of an export'):
        library.export_library(None, tmp_path)


def test_export_without_a_compiler_writes_nothing(tmp_path, monkeypatch):
    loop = ClosedLoop(resolve('quick'))
    monkeypatch.setenv('PATH', str(tmp_path / 'empty'))
    monkeypatch.setattr(library, 'compile_entries', lambda *_: b'')
    with pytest.raises(RunError, match='expected ar'):
        library.export_library(loop.control, tmp_path / 'out')
    loop.close()
    assert list(tmp_path.iterdir()) == []


def test_export_names_a_target_that_is_unknown(tmp_path):
    loop = ClosedLoop(resolve('quick'))
    with pytest.raises(ConfigError, match='target'):
        library.export_library(loop.control, tmp_path / 'out', target='pdp11-unknown')
    loop.close()
    assert list(tmp_path.iterdir()) == []
