"""Soaks as jobs: each a closed loop or a graph of its own, for some hours."""

from __future__ import annotations

from dataclasses import asdict, dataclass
import time
from typing import Any, ClassVar

from multicontact_control.experiment.faults.situation import with_obstacles
from multicontact_control.experiment.scenario import resolve, Setup
from multicontact_control.experiment.soak import Soak, SoakOutcome
from multicontact_control.experiment.study.jobs import content_key, JobResult, setup_content
from multicontact_control.files import finite

SCENARIO = 'quick'


@dataclass(frozen=True)
class SoakJob:
    """A soak of one plant in one process or over a graph, from a seed on, for some hours."""

    plant: str
    seed: int
    hours: float
    graph: bool = False

    supervised: ClassVar[bool] = True

    def setup(self) -> Setup:
        """Return the arm and what surrounds it."""
        if self.graph:
            return resolve(SCENARIO, plant=self.plant, seed=self.seed)
        return with_obstacles(SCENARIO, self.plant, self.seed)

    def key(self) -> str:
        """Return the hash of all that decides the outcome; see `Job.key`."""
        return content_key('soak', {**self.describe(), **setup_content(self.setup())})

    def simulated_time(self) -> float:
        """Return how long it is [s]."""
        return 3600.0 * self.hours

    def describe(self) -> dict[str, Any]:
        """Return plant, seed, hours, and whether it is over a graph."""
        return asdict(self)


def run_soak_job(job: SoakJob) -> JobResult:
    """Run a soak; `metrics` are its `SoakOutcome`."""
    start = time.perf_counter()
    soak = Soak(job.setup(), job.seed)
    try:
        outcome = soak.run(job.simulated_time())
    finally:
        soak.close()
    return soak_result(outcome, time.perf_counter() - start)


def soak_result(outcome: SoakOutcome, wall: float) -> JobResult:
    """Return a soak that has taken some time [s] as the result of a job."""
    metrics = {**vars(outcome), 'episodes': dict(outcome.episodes),
               'counts': dict(outcome.counts), 'minutes': [*map(asdict, outcome.minutes)]}
    return JobResult(finite(metrics), {}, wall)
