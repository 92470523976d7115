"""Faults as jobs: a few in one situation, each in a copy of a process that has got there."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from multiprocessing.connection import Pipe
import os
import signal
import time
import traceback
from typing import Any

from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.fault import (
    APPROACH,
    Fault,
    PROCESS,
    REST,
    SLIDING,
    START,
)
from multicontact_control.experiment.faults.in_process import run_fault, together
from multicontact_control.experiment.faults.judge import FaultRow
from multicontact_control.experiment.faults.situation import with_obstacles
from multicontact_control.experiment.faults.vocabulary import faults_of
from multicontact_control.experiment.scenario import Setup
from multicontact_control.experiment.study.jobs import content_key, JobResult, setup_content

SCENARIO = 'quick'
PHASE_TIMES = {START: 0.0, APPROACH: 0.65, REST: 4.9, SLIDING: 8.2}  # s
FAULT_TIMEOUT = 60.0  # s


@dataclass(frozen=True)
class FaultJob:
    """Some faults in one situation."""

    plant: str
    phase: str
    first_seed: int  # of the plant
    # Kind, input and seed of each, and kind and input of another at the same time, if any.
    faults: tuple[tuple[Any, ...], ...]

    def setup(self) -> Setup:
        """Return the scenario in which they happen."""
        return with_obstacles(SCENARIO, self.plant, self.first_seed)

    def key(self) -> str:
        """Return the hash of all that decides the outcome; see `Job.key`."""
        return content_key('faults', {
            **self.describe(), **setup_content(self.setup()), 'time': PHASE_TIMES[self.phase]})

    def describe(self) -> dict[str, Any]:
        """Return the situation and the faults."""
        return {'plant': self.plant, 'phase': self.phase, 'first_seed': self.first_seed,
                'faults': [list(fault) for fault in self.faults]}


def run_fault_job(job: FaultJob) -> JobResult:
    """Run the faults of a job; `metrics` of the result has a row for each under `rows`."""
    start = time.perf_counter()
    known = faults_of(PROCESS)
    world = _world_at(job)
    rows = [asdict(in_fork(world, known[kind, source], seed, job.phase, known.get(tuple(other))))
            for kind, source, seed, *other in job.faults]
    return JobResult({'rows': rows}, {}, time.perf_counter() - start)


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


def in_fork(
    world: ClosedLoop, fault: Fault, seed: int, phase: str, other: Fault | None = None,
) -> FaultRow:
    """Run one fault, or two, in a copy of this process; a copy that hangs or dies is not safe."""
    ours, theirs = Pipe(duplex=False)
    # By hand: a worker of Dask is not allowed to have children of `multiprocessing`.
    child = os.fork()
    if not child:
        try:
            theirs.send(run_fault(world, fault, seed, phase, other))
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(0)  # at once: what this process would end is its parent's
    theirs.close()
    try:
        if ours.poll(FAULT_TIMEOUT):
            row: FaultRow = ours.recv()
            return row
        problem = 'hang'
    except EOFError:
        problem = 'died'
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        ours.close()
    named = fault if other is None else together(fault, other)
    return FaultRow(named.kind, named.input, seed, problem, -1.0, -1.0, -1.0, False,
                    world.setup.plant_name, phase, problem)
