"""Faults as jobs: a few in one situation, each in a copy of a process that has got there."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass
import logging
import math
from multiprocessing.connection import Pipe
import os
import signal
import traceback
from typing import Any

from multicontact_control.faults.fault_run import resolve_with_obstacles, run_fault
from multicontact_control.faults.outcomes import FaultRow
from multicontact_control.faults.vocabulary import (
    APPROACH,
    combine_faults,
    draw_pairs,
    Fault,
    FAULTS,
    PHASES,
    REST,
    SLIDING,
    START,
)
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import Setup
from multicontact_control.study.cells import Cell
from multicontact_control.study.config import PartConfig
from multicontact_control.study.jobs import outcome_key
from multicontact_control.study.study import Metrics, Study
import pandas as pd

PHASE_TIMES = {START: 0.0, APPROACH: 0.65, REST: 4.9, SLIDING: 8.2}  # s, in this order
FAULT_TIMEOUT = 60  # s
FAULTS_PER_JOB = 12
PAIRS = 300  # of faults at the same time
FEW_PAIRS = 12  # likewise, with a single seed
# Kind and input of a fault, or of two at the same time.
Names = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class FaultJob:
    """
    Some faults in one phase of a scenario, each in the state that the run has come to there.

    The way there takes up to 8.2 s of the simulation, a fault 1.2 s: so a job goes there once for
    up to 12 of them, and each happens in a fork of the process.
    """

    scenario: str
    plant: str
    phase: str
    first_seed: int  # of the plant
    faults: tuple[tuple[Names, int], ...]  # with their seeds

    def setup(self) -> Setup:
        """
        Return the scenario in which they happen, with obstacles far away.

        Its seed is the study's first for all jobs: seeds of faults decide only on their own
        details.
        """
        return resolve_with_obstacles(self.scenario, self.plant, self.first_seed)

    def key(self) -> str:
        """
        Return the hash of all that decides the outcome; see `outcome_key`.

        These are the setup, the time at which the phase begins, and the names and seeds of the
        faults.
        """
        time = PHASE_TIMES[self.phase]
        return outcome_key('faults', self.setup(), time=time, job=asdict(self))

    def run(self) -> dict[str, Any]:
        """
        Run the faults; a row for each is under `rows`, in the order of `faults`.

        The world of the plant is brought to the phase first, and left there for the next job of
        this process.
        """
        world = _advance_world(self)
        rows = []
        for names, seed in self.faults:
            faults = [FAULTS[name] for name in names]
            row = run_in_fork(world, combine_faults(*faults), seed, self.phase)
            rows.append(asdict(row))
        return {'rows': rows}


# The worlds of this process by plant: faults happen in copies of them, so that a later phase
# goes on from an earlier one.
_WORLDS: dict[str, ClosedLoop] = {}


def _advance_world(job: FaultJob) -> ClosedLoop:
    """Return the world of a job's plant at the beginning of its phase."""
    setup = job.setup()
    tick = round(PHASE_TIMES[job.phase] * setup.controller.rate)
    world = _WORLDS.get(job.plant)
    if world is None or world.tick > tick or world.setup != setup:
        if world is not None:
            world.plant.close()
        world = ClosedLoop(setup)
        _WORLDS[job.plant] = world
    while world.tick < tick:
        world.advance()
    return world


def run_in_fork(world: ClosedLoop, fault: Fault, seed: int, phase: str) -> FaultRow:
    """
    Run a fault in a copy of this process, which leaves the world as it is.

    So the next fault finds the same state, without running up to it again. A copy that hangs for
    60 s or dies is not safe: its row has the reaction `died` and no figures.
    """
    ours, theirs = Pipe(duplex=False)
    # By hand: a worker of Dask is not allowed to have children of `multiprocessing`.
    child = os.fork()
    if not child:
        signal.alarm(FAULT_TIMEOUT)
        if fault.breaks_part:
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
            kind=fault.kind,
            input=fault.input,
            seed=seed,
            reaction='died',
            time_to_safe_s=math.inf,
            peak_force_n=0.0,
            peak_torque_fraction=0.0,
            safe=False,
            plant=world.setup.plant_name,
            phase=phase,
            problems='died',
        )
    finally:
        ours.close()
        os.waitpid(child, 0)


class FaultsStudy(Study):
    """
    Kinds of faults and seeds, in the phases in turn, and pairs of faults.

    Of a single seed there is one fault of each kind, in the phase and on the plant whose turn it
    is.
    """

    def plan_cells(self) -> list[Cell]:
        """
        Return the jobs, early phases first, and the faults of a phase on a plant in some.

        A worker that takes them in this order goes on with its world from phase to phase and
        begins anew only where it must.
        """
        (part,) = self.config.parts.values()
        first_seed = part.seeds[0]
        faults_by_place = self._spread_faults(part)
        cells = []
        for phase in PHASE_TIMES:
            for plant in part.plants:
                faults = faults_by_place[phase, plant]
                for begin in range(0, len(faults), FAULTS_PER_JOB):
                    some = tuple(faults[begin : begin + FAULTS_PER_JOB])
                    job = FaultJob(part.scenario, plant, phase, first_seed, some)
                    cells.append(Cell({'plant': plant, 'phase': phase}, job, job.key()))
        return cells

    def _spread_faults(
        self, part: PartConfig
    ) -> Mapping[tuple[str, str], list[tuple[Names, int]]]:
        """Return faults with their seeds by phase and plant, as their turns come."""
        plants = part.plants
        seeds = part.seeds
        faults_by_place: defaultdict[tuple[str, str], list[tuple[Names, int]]]
        faults_by_place = defaultdict(list)

        def put_in_turn(
            turn: int, phases: tuple[str, ...], names: Names, seed: int
        ) -> None:
            """Put a fault where it is its turn: all plants come, then all phases."""
            phase = phases[turn // len(plants) % len(phases)]
            plant = plants[turn % len(plants)]
            faults_by_place[phase, plant].append((names, seed))

        for index, (name, fault) in enumerate(FAULTS.items()):
            phases: tuple[str, ...] = PHASES
            if fault.from_start:
                phases = (START, *PHASES)
            if len(seeds) > 1:
                for turn, seed in enumerate(seeds):
                    put_in_turn(turn, phases, (name,), seed)
            else:
                turn = index % (len(plants) * len(PHASES))
                put_in_turn(turn, phases, (name,), seeds[0] + turn)
        pair_count = PAIRS
        if len(seeds) == 1:
            pair_count = FEW_PAIRS
        for turn, pair in enumerate(draw_pairs(pair_count, seeds[0])):
            put_in_turn(turn, PHASES, pair, seeds[0] + turn)
        return faults_by_place

    def table_rows(self, metrics: Metrics) -> list[dict[str, Any]]:
        """
        Return a row for each fault of a job; see `FaultRow`.

        A time that is infinite has become None on its way through JSON, and `complete_table` makes
        it infinite again.
        """
        return list(metrics['rows'])

    def complete_table(self, frame: pd.DataFrame) -> pd.DataFrame:
        """
        Return the rows by kind and seed, those of pairs last; what never came is infinite.

        The problems of a fault, or else its shortfalls, are the `error` of its row, which the page
        lists as a remark; `back` is false with a shortfall.
        """
        order = {name: place for place, name in enumerate(FAULTS)}
        names = zip(frame['kind'], frame['input'])
        problems = frame['problems'].where(frame['problems'] != '', frame['shortfalls'])
        times = frame['time_to_safe_s'].astype(float)
        completed = frame.assign(
            error=problems.where(problems != '', None),
            back=frame['shortfalls'] == '',
            time_to_safe_s=times.fillna(math.inf),
            place=[order.get(name, len(order)) for name in names],
        )
        ordered = completed.sort_values(
            ['place', 'seed'], kind='stable', ignore_index=True
        )
        return ordered.drop(columns='place')
