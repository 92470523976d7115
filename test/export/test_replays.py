"""Whole runs and faults, by the C library of their controllers; and what checkers see of it."""

import os
from pathlib import Path
from random import Random
import shutil
import subprocess

from exported import build_replay, replayed
from multicontact_control.export.library import export_library
from multicontact_control.faults import fault_run
from multicontact_control.faults.fault_run import resolve_with_obstacles
from multicontact_control.faults.vocabulary import APPROACH, FAULTS, REST, SLIDING
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
from multicontact_control.study.presets import faults
from multicontact_control.study.presets.faults import PHASE_TIMES
import pytest
from robots import has_urdf

FAULTS_EACH = 68  # of each phase
CHECKED_TICKS = 500  # by programs that are slow
pytestmark = pytest.mark.nightly


def build(loop: ClosedLoop, folder: Path, *options: str, target: str = '') -> Path:
    """Return the program that replays a controller, whose library is made in a folder."""
    export_library(loop.control, folder / 'tick', target=target)
    return build_replay(folder / 'tick', *options)


@pytest.mark.parametrize(
    ('scenario', 'options'),
    [
        ('paper', {}),
        ('paper', {'preset': 'paper'}),
        ('edge', {}),
        ('plane', {}),
        ('disturbance', {}),
        ('quick', {'robot': 'panda'}),
        pytest.param(
            'quick',
            {'robot': 'fr3'},
            marks=pytest.mark.skipif(not has_urdf('fr3'), reason='needs [franka]'),
        ),
    ],
)
def test_tick_of_a_run_is_that_of_python(scenario, options, tmp_path):
    loop = ClosedLoop(resolve(scenario, **options))
    with replayed(loop.control, build(loop, tmp_path)) as replay:
        for _ in range(loop.setup.ticks):
            loop.advance()
    loop.close()
    assert replay.calls > 2 * loop.setup.ticks


def test_faults_are_answered_as_by_python(tmp_path, monkeypatch):
    """Each in a copy of the process, whose replay begins with the records of that moment."""
    loop = ClosedLoop(resolve_with_obstacles('quick', 'rigid', 0))
    program = build(loop, tmp_path)
    equal = tmp_path / 'equal'

    def run_fault_replayed(world, fault, seed, phase):
        with replayed(world.control, program) as replay:
            row = fault_run.run_fault(world, fault, seed, phase)
        with equal.open('a') as file:
            file.write(f'{replay.calls}\n')
        return row

    monkeypatch.setattr(faults, 'run_fault', run_fault_replayed)
    count = 0
    random = Random(0)
    for phase in (APPROACH, REST, SLIDING):
        time = PHASE_TIMES[phase]
        while loop.tick < round(time * loop.setup.controller.rate):
            loop.advance()
        of_phase = [fault for fault in FAULTS.values() if phase in fault.phases]
        for fault in random.sample(of_phase, FAULTS_EACH):
            row = faults.run_in_fork(loop, fault, 1, phase)
            assert row.problems != 'died', (fault.kind, fault.input, phase)
            count += 1
    loop.close()
    calls = [int(line) for line in equal.read_text().split()]
    assert len(calls) == count > 200


@pytest.mark.parametrize('checker', ['valgrind', 'address'])
def test_checkers_of_memory_find_nothing(checker, tmp_path):
    """Valgrind follows the library itself, made for any x86-64; ASan the header's functions."""
    if shutil.which('valgrind') is None or os.uname().machine != 'x86_64':
        pytest.skip('needs valgrind on x86-64')
    options, command = [], ['valgrind', '--error-exitcode=3', '--quiet']
    if checker == 'address':
        options, command = ['-fsanitize=address,undefined'], []
    loop = ClosedLoop(resolve('quick'), commanded=True)
    program = build(loop, tmp_path, *options, target='x86_64-linux-gnu')
    with replayed(loop.control, program, *command):
        for tick in range(CHECKED_TICKS):
            loop.advance()
            if tick == 10:
                loop.control.set_forces({'table': 5.0})
    loop.close()


def test_library_for_another_processor_is_made(tmp_path):
    """Its functions are there; it is not run here."""
    loop = ClosedLoop(resolve('quick'))
    export_library(loop.control, tmp_path / 'tick', target='aarch64-linux-gnu')
    loop.close()
    listed = subprocess.run(
        ['nm', '--print-armap', tmp_path / 'tick/libmulticontact_tick.a'],
        capture_output=True,
        text=True,
        check=True,
    )
    assert 'mc_run in multicontact_tick.o' in listed.stdout
