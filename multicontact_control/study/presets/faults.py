"""Faults as jobs: a few in one situation, each in a copy of a process that has got there."""

from __future__ import annotations

from dataclasses import asdict, dataclass
import logging
import math
from multiprocessing.connection import Pipe
import os
import signal
import traceback
from typing import Any

from multicontact_control.faults.in_process import run_fault, with_obstacles
from multicontact_control.faults.judge import FaultRow
from multicontact_control.faults.vocabulary import (
    APPROACH,
    Breakdown,
    Fault,
    FAULTS,
    pairs_of_faults,
    PHASES,
    REST,
    SLIDING,
    START,
    together,
)
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import Setup
from multicontact_control.study.cells import Cell
from multicontact_control.study.jobs import content_key, setup_content
from multicontact_control.study.study import Metrics, Study
import pandas as pd

PHASE_TIMES = {START: 0.0, APPROACH: 0.65, REST: 4.9, SLIDING: 8.2}  # s, in this order
FAULT_TIMEOUT = 60  # s
FAULTS_PER_JOB = 12
PAIRS, FEW_PAIRS = 300, 12  # of faults at the same time, the latter with a single seed
Names = tuple[
    tuple[str, str], ...
]  # kind and input of a fault, or of two at the same time


@dataclass(frozen=True)
class FaultJob:
    """Some faults in one situation."""

    scenario: str
    plant: str
    phase: str
    first_seed: int  # of the plant
    faults: tuple[tuple[Names, int], ...]  # with their seeds

    def setup(self) -> Setup:
        """Return the scenario in which they happen."""
        return with_obstacles(self.scenario, self.plant, self.first_seed)

    def key(self) -> str:
        """Return the hash of all that decides the outcome."""
        return content_key(
            'faults',
            {
                **asdict(self),
                **setup_content(self.setup()),
                'time': PHASE_TIMES[self.phase],
            },
        )

    def run(self) -> dict[str, Any]:
        """Run the faults; a row for each is under `rows`."""
        world = _world_at(self)
        return {
            'rows': [
                asdict(
                    in_fork(
                        world,
                        together(*map(FAULTS.__getitem__, names)),
                        seed,
                        self.phase,
                    )
                )
                for names, seed in self.faults
            ]
        }


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
        if any(isinstance(part.action, Breakdown) for part in fault.parts or (fault,)):
            logging.disable()  # of what is raised on purpose
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
        return FaultRow(
            fault.kind,
            fault.input,
            seed,
            'died',
            math.inf,
            0.0,
            0.0,
            False,
            world.setup.plant_name,
            phase,
            'died',
        )
    finally:
        ours.close()
        os.waitpid(child, 0)


class FaultsStudy(Study):
    """Kinds of faults and seeds, in the situations in turn, and pairs of faults."""

    def cells(self) -> list[Cell]:
        """Return the jobs, early phases first; of a single seed one fault of each kind."""
        (part,) = self.config.parts.values()
        plants, seeds = part.plants, part.seeds
        places: dict[tuple[str, str], list[tuple[Names, int]]] = {
            (phase, plant): [] for phase in PHASE_TIMES for plant in plants
        }

        def put(number: int, phases: tuple[str, ...], names: Names, seed: int) -> None:
            """Put a fault where it is the turn of its number: all plants, then all phases."""
            phase = phases[number // len(plants) % len(phases)]
            places[phase, plants[number % len(plants)]].append((names, seed))

        for index, (name, fault) in enumerate(FAULTS.items()):
            phases = (START, *PHASES) if fault.from_start else PHASES
            turn = index % (len(plants) * len(PHASES))
            for number, seed in (
                enumerate(seeds) if len(seeds) > 1 else [(turn, seeds[0] + turn)]
            ):
                put(number, phases, (name,), seed)
        pairs = pairs_of_faults(PAIRS if len(seeds) > 1 else FEW_PAIRS, seeds[0])
        for number, pair in enumerate(pairs):
            put(number, PHASES, pair, seeds[0] + number)
        jobs = [
            FaultJob(
                part.scenario,
                plant,
                phase,
                seeds[0],
                tuple(faults[i : i + FAULTS_PER_JOB]),
            )
            for (phase, plant), faults in places.items()
            for i in range(0, len(faults), FAULTS_PER_JOB)
        ]
        return [
            Cell({'plant': job.plant, 'phase': job.phase}, job, job.key())
            for job in jobs
        ]

    def rows(self, metrics: Metrics) -> list[dict[str, Any]]:
        """Return a row for each fault."""
        return list(metrics['rows'])

    def complete(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the rows by kind and seed, those of pairs last; what never came is infinite."""
        order = {name: i for i, name in enumerate(FAULTS)}
        places = [
            order.get(name, len(order)) for name in zip(frame['kind'], frame['input'])
        ]
        problems = frame['problems'].where(frame['problems'] != '', frame['shortfalls'])
        return (
            frame.assign(
                error=problems.where(problems != '', None),
                back=frame['shortfalls'] == '',
                time_to_safe_s=frame['time_to_safe_s'].astype(float).fillna(math.inf),
                place=places,
            )
            .sort_values(['place', 'seed'], kind='stable', ignore_index=True)
            .drop(columns='place')
        )
