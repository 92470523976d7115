"""Faults as cells: a few in one situation, each in a copy of a process that has got there."""

from __future__ import annotations

from dataclasses import dataclass
import multiprocessing
from multiprocessing.connection import Connection
import time
from typing import Any

from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.engine import CellResult
from multicontact_control.experiment.engine.cells import content_key, setup_content
from multicontact_control.experiment.faults.in_process import FaultRow, run_fault
from multicontact_control.experiment.faults.vocabulary import (
    APPROACH,
    fault_kinds,
    FaultKind,
    REST,
    SLIDING,
)
from multicontact_control.experiment.scenario import resolve, Setup

SCENARIO = 'quick'
PHASE_TIMES = {APPROACH: 0.65, REST: 4.9, SLIDING: 8.2}  # s
FAULT_TIMEOUT = 60.0  # s

Fault = tuple[str, str, int]  # kind, input, seed


@dataclass(frozen=True)
class FaultCell:
    """
    Some faults in one situation.

    Attributes
    ----------
    plant, phase
        Where they happen.
    first_seed
        Of the plant.
    faults
        Kind, input and seed of each.

    """

    plant: str
    phase: str
    first_seed: int
    faults: tuple[Fault, ...]

    def setup(self) -> Setup:
        """Return the scenario in which they happen."""
        return resolve(SCENARIO, plant=self.plant, seed=self.first_seed)

    def key(self) -> str:
        """Return the hash of all that decides the outcome; see `Cell.key`."""
        return content_key('faults', {
            **self.describe(), **setup_content(self.setup()), 'time': PHASE_TIMES[self.phase]})

    def describe(self) -> dict[str, Any]:
        """Return the situation and the faults."""
        return {'plant': self.plant, 'phase': self.phase, 'first_seed': self.first_seed,
                'faults': [list(fault) for fault in self.faults]}


def run_fault_cell(cell: FaultCell) -> CellResult:
    """
    Run the faults of a cell.

    Returns
    -------
    CellResult
        `metrics`: a row for each fault under `rows`.

    """
    start = time.perf_counter()
    kinds = {(kind.kind, kind.input): kind for kind in fault_kinds()}
    world = _world_at(cell)
    rows = [in_fork(world, kinds[kind, source], seed, cell.phase).as_json()
            for kind, source, seed in cell.faults]
    return CellResult({'rows': rows}, {}, time.perf_counter() - start)


# The worlds of this process by plant: faults happen in copies of them, so that a later phase
# goes on from an earlier one, and no fault costs the way there.
_WORLDS: dict[str, ClosedLoop] = {}


def _world_at(cell: FaultCell) -> ClosedLoop:
    setup = cell.setup()
    tick = round(PHASE_TIMES[cell.phase] * setup.controller.rate)
    world = _WORLDS.get(cell.plant)
    if world is None or world.tick > tick or world.setup != setup:
        if world is not None:
            world.plant.close()
        world = _WORLDS[cell.plant] = ClosedLoop(setup)
    while world.tick < tick:
        world.advance()
    return world


def in_fork(world: ClosedLoop, kind: FaultKind, seed: int, phase: str) -> FaultRow:
    """Run one fault in a copy of this process; a copy that hangs or dies is not safe."""
    context = multiprocessing.get_context('fork')
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_child, args=(world, kind, seed, phase, theirs))
    child.start()
    theirs.close()
    try:
        if ours.poll(FAULT_TIMEOUT):
            row: FaultRow = ours.recv()
            return row
        problem = 'hang'
    except EOFError:
        problem = 'died'
    finally:
        child.kill() if child.is_alive() and not ours.poll(0) else None
        child.join()
        ours.close()
    return FaultRow(kind.kind, kind.input, seed, problem, -1.0, -1.0, -1.0, False,
                    world.setup.plant_name, phase, problem)


def _child(world: ClosedLoop, kind: FaultKind, seed: int, phase: str, pipe: Connection) -> None:
    pipe.send(run_fault(world, kind, seed, phase))
    pipe.close()
