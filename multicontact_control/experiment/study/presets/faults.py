"""Faults as jobs: a few in one situation, each in a copy of a process that has got there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
import math
from multiprocessing.connection import Pipe
import os
import signal
import traceback
from typing import Any

from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.in_process import run_fault, together, with_obstacles
from multicontact_control.experiment.faults.judge import FaultRow
from multicontact_control.experiment.faults.vocabulary import (
    APPROACH,
    Fault,
    FAULTS,
    pairs_of_faults,
    PHASES,
    REST,
    SLIDING,
    START,
    TWO,
)
from multicontact_control.experiment.scenario import Setup
from multicontact_control.experiment.study.cells import Cell
from multicontact_control.experiment.study.jobs import content_key, setup_content
from multicontact_control.experiment.study.study import Metrics, Study
import pandas as pd

PHASE_TIMES = {START: 0.0, APPROACH: 0.65, REST: 4.9, SLIDING: 8.2}  # s
FAULT_TIMEOUT = 60  # s
FAULTS_PER_JOB = 12
PAIRS, FEW_PAIRS = 300, 12  # of faults at the same time, the latter with a single seed


@dataclass(frozen=True)
class FaultJob:
    """Some faults in one situation."""

    scenario: str
    plant: str
    phase: str
    first_seed: int  # of the plant
    # Kind, input and seed of each, and kind and input of another at the same time, if any.
    faults: tuple[tuple[Any, ...], ...]

    def setup(self) -> Setup:
        """Return the scenario in which they happen."""
        return with_obstacles(self.scenario, self.plant, self.first_seed)

    def key(self) -> str:
        """Return the hash of all that decides the outcome; see `Job.key`."""
        return content_key('faults', {
            **asdict(self), **setup_content(self.setup()), 'time': PHASE_TIMES[self.phase]})

    def run(self) -> dict[str, Any]:
        """Run the faults; a row for each is under `rows`."""
        world = _world_at(self)
        return {'rows': [
            asdict(in_fork(world, together(FAULTS[kind, source], FAULTS[other[0], other[1]])
                           if other else FAULTS[kind, source], seed, self.phase))
            for kind, source, seed, *other in self.faults]}


# The worlds of this process by plant: faults happen in copies of them, so that a later phase
# goes on from an earlier one.
_WORLDS: dict[str, ClosedLoop] = {}


def _world_at(job: FaultJob) -> ClosedLoop:
    setup = job.setup()
    tick = round(PHASE_TIMES[job.phase] * setup.controller.rate)
    world = _WORLDS.get(job.plant)
    if world is None or world.tick > tick or world.setup != setup:
        if world is not None:
            world.plant.close()
        world = _WORLDS[job.plant] = ClosedLoop(setup)
    while world.tick < tick:
        world.advance()
    return world


def in_fork(world: ClosedLoop, fault: Fault, seed: int, phase: str) -> FaultRow:
    """Run a fault in a copy of this process; a copy that hangs or dies is not safe."""
    ours, theirs = Pipe(duplex=False)
    # By hand: a worker of Dask is not allowed to have children of `multiprocessing`.
    child = os.fork()
    if not child:
        signal.alarm(FAULT_TIMEOUT)
        try:
            theirs.send(run_fault(world, fault, seed, phase))
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(0)  # at once: what this process would end is its parent's
    theirs.close()
    try:
        row: FaultRow = ours.recv()
        return row
    except EOFError:
        return FaultRow(fault.kind, fault.input, seed, 'died', -1.0, -1.0, -1.0, False,
                        world.setup.plant_name, phase, 'died')
    finally:
        ours.close()
        os.waitpid(child, 0)


class FaultsStudy(Study):
    """Kinds of faults and seeds, in the situations in turn, and pairs of faults."""

    def cells(self) -> list[Cell]:
        """
        Return the faults, up to 12 in a job, early phases first.

        In this order a worker that has got to one phase only has to go on to the next. A single
        seed stands for one fault of each kind, spread over the situations.
        """
        part, = self.config.parts.values()
        plants, seeds = part.plants, part.seeds
        spread = len(plants) * len(PHASES)
        numbered: list[tuple[int, Sequence[str], tuple[Any, ...]]] = []
        for index, (name, fault) in enumerate(FAULTS.items()):
            phases = (START, *PHASES) if fault.from_start else PHASES
            numbers = [(index % spread, seeds[0] + index % spread)] if len(seeds) == 1 else (
                enumerate(seeds))
            numbered += [(number, phases, (*name, seed)) for number, seed in numbers]
        pairs = pairs_of_faults(PAIRS if len(seeds) > 1 else FEW_PAIRS, seeds[0])
        numbered += [
            (number, PHASES, (one.kind, one.input, seeds[0] + number, other.kind, other.input))
            for number, (one, other) in enumerate(pairs)]
        places: dict[tuple[str, str], list[tuple[Any, ...]]] = {
            (plant, phase): [] for phase in sorted(PHASE_TIMES, key=PHASE_TIMES.__getitem__)
            for plant in plants}
        for number, situations, work in numbered:  # all plants, then all phases, in turn
            places[plants[number % len(plants)],
                   situations[number // len(plants) % len(situations)]].append(work)
        jobs = [FaultJob(part.scenario, plant, phase, seeds[0],
                         tuple(faults[i:i + FAULTS_PER_JOB]))
                for (plant, phase), faults in places.items()
                for i in range(0, len(faults), FAULTS_PER_JOB)]
        return [Cell({'plant': job.plant, 'phase': job.phase}, job, job.key()) for job in jobs]

    def rows(self, metrics: Metrics) -> list[dict[str, Any]]:
        """Return a row for each fault; what never came is infinite, what is not known is none."""
        return [{**row, 'error': row['problems'] or row['shortfalls'] or None,
                 'back': not row['shortfalls'],
                 'time_to_safe_s': row['time_to_safe_s'] if row['time_to_safe_s'] >= 0.0 else (
                     math.inf),
                 'off_command_s': row['off_command_s'] if row['off_command_s'] >= 0.0 else None}
                for row in metrics['rows']]

    def complete(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the rows by kind and seed; pairs are one kind."""
        order = {name: i for i, name in enumerate(FAULTS)}
        places = [order.get(name, len(order)) for name in zip(frame['kind'], frame['input'])]
        pairs = frame['input'].where(frame['kind'] == TWO, '')
        return frame.assign(
            pair=pairs, input=frame['input'].mask(frame['kind'] == TWO, ''), place=places,
        ).sort_values(['place', 'seed'], kind='stable', ignore_index=True).drop(columns='place')
