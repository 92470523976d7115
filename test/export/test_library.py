"""The tick as a C library: what it needs, what it refuses, and that it is the one of Python."""

from pathlib import Path
import re
import subprocess

from exported import build_replay, replayed, STRICT
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.export import library
from multicontact_control.export.library import (
    export_library,
    HEADER,
    pack_records,
    RECORDS,
)
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest

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
    folder = tmp_path_factory.mktemp('export') / 'quick'
    loop = ClosedLoop(resolve('quick'))
    export_library(loop.control, folder)
    loop.close()
    return folder


@pytest.fixture(scope='module')
def program(quick) -> Path:
    return build_replay(quick)


def test_library_needs_nothing_but_mathematics(quick):
    """So no call allocates, locks or enters the system."""
    listed = subprocess.run(
        ['nm', '--undefined-only', quick / 'libmulticontact_tick.a'],
        capture_output=True,
        text=True,
        check=True,
    )
    symbols = set(re.findall(r' U (\w+)', listed.stdout))
    assert symbols <= HARMLESS | MATHEMATICS


def test_records_are_those_of_the_configured_controller(quick):
    loop = ClosedLoop(resolve('quick'))
    assert (quick / RECORDS).read_bytes() == pack_records(loop.control)
    loop.close()


def test_tick_of_quick_is_that_of_python(program):
    loop = ClosedLoop(resolve('quick'))
    with replayed(loop.control, program) as replay:
        for _ in range(loop.setup.ticks):
            loop.advance()
    loop.close()
    assert replay.calls > 2 * loop.setup.ticks


def test_commands_and_reactions_are_those_of_python(program):
    """Forces, a hold, a wrench that is lost, a retry, a lock, and the safe behaviour."""
    loop = ClosedLoop(resolve('quick'), commanded=True)
    control = loop.control

    def advance(ticks, corrupt=None):
        for _ in range(ticks):
            loop.advance(corrupt)

    with replayed(control, program):
        advance(50)
        control.set_forces({'table': 8.0, 'board': 5.0})
        advance(900)
        control.hold(True)
        advance(100)
        control.hold(False)
        advance(100)
        advance(60, lambda inputs: inputs._replace(wrench=None))
        assert loop.status.reaction == 'hold'
        control.supervisor.request_retry()
        advance(400)
        assert loop.control.output.answer['active'].any()
        advance(60, lambda inputs: inputs._replace(joints=None))
        assert loop.status.reaction == 'float'
        advance(300)
        control.supervisor.gate.start_blend()
        control.supervisor.task.set_lock(True)
        advance(100)
        loop.command = control.stop()
        for _ in range(100):
            loop.act()
            loop.command = control.step(loop.inputs())
    loop.close()


@pytest.mark.parametrize('language', ['c', 'c++'])
def test_header_compiles_without_a_warning(quick, language, tmp_path):
    program = tmp_path / 'program'
    program.write_text(f'#include "{HEADER}"\n')
    standard = {'c': '-std=c11', 'c++': '-std=c++17'}[language]
    done = subprocess.run(
        ['gcc', standard, *STRICT[1:], '-I', quick, '-x', language, '-c', program]
        + ['-o', tmp_path / 'program.o'],
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, '')


@pytest.mark.parametrize(
    ('place', 'refused'), [(0, '1'), (8, '2'), (16, '1'), (None, '1')]
)
def test_records_of_another_layout_are_refused(
    quick, program, tmp_path, place, refused
):
    content = bytearray((quick / RECORDS).read_bytes())
    if place is None:
        content.pop()
    else:
        content[place] ^= 1
    records = tmp_path / RECORDS
    records.write_bytes(content)
    done = subprocess.run([program, records], capture_output=True, text=True, input='')
    assert done.stderr == f'records refused: {refused}\n'


def test_difference_of_a_bit_is_named(program):
    """The comparison can say no."""
    loop = ClosedLoop(resolve('quick'))
    viscous = loop.control.supervisor.records.joints['config']['viscous']
    with pytest.raises(pytest.fail.Exception, match=r'joints\[0\]\.config\.viscous'):
        with replayed(loop.control, program):
            for _ in range(10):
                loop.advance()
            viscous[0] = np.nextafter(viscous[0], np.inf)
            loop.advance()
    loop.close()


def test_export_leaves_a_folder_of_something_else_alone(tmp_path):
    (tmp_path / 'thesis.tex').touch()
    with pytest.raises(ConfigError, match='thesis.tex'):
        export_library(None, tmp_path)


@pytest.mark.parametrize('missing', ['ar', 'cc'])
def test_export_without_a_tool_writes_nothing(tmp_path, monkeypatch, missing):
    tools = tmp_path / 'tools'
    tools.mkdir()
    if missing == 'cc':
        (tools / 'ar').symlink_to('/usr/bin/true')
    loop = ClosedLoop(resolve('quick'))
    monkeypatch.setenv('PATH', str(tools))
    monkeypatch.setattr(library, 'compile_entries', lambda *_: b'')
    with pytest.raises(RunError, match=f'expected {missing}'):
        export_library(loop.control, tmp_path / 'out')
    loop.close()
    assert list(tmp_path.iterdir()) == [tools]


def test_export_names_a_target_that_is_unknown(tmp_path):
    loop = ClosedLoop(resolve('quick'))
    with pytest.raises(ConfigError, match='target'):
        export_library(loop.control, tmp_path / 'out', target='pdp11-unknown')
    loop.close()
    assert list(tmp_path.iterdir()) == []
