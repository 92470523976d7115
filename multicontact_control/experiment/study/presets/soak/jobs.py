"""Soaks as jobs: each a closed loop of its own, for some simulated hours."""

from __future__ import annotations

from dataclasses import asdict, dataclass
import time
from typing import Any, ClassVar

from multicontact_control.experiment.faults.situation import with_obstacles
from multicontact_control.experiment.scenario import Setup
from multicontact_control.experiment.soak import Soak
from multicontact_control.experiment.study.jobs import content_key, JobResult, setup_content
from multicontact_control.files import finite

SCENARIO = 'quick'


@dataclass(frozen=True)
class SoakJob:
    """A soak of one plant in one process, from a seed on, for some simulated hours."""

    plant: str
    seed: int
    hours: float

    supervised: ClassVar[bool] = True

    def setup(self) -> Setup:
        """Return the arm and what surrounds it."""
        return with_obstacles(SCENARIO, self.plant, self.seed)

    def key(self) -> str:
        """Return the hash of all that decides the outcome; see `Job.key`."""
        return content_key('soak', {**self.describe(), **setup_content(self.setup())})

    def simulated_time(self) -> float:
        """Return how long it is [s]."""
        return 3600.0 * self.hours

    def describe(self) -> dict[str, Any]:
        """Return plant, seed and hours."""
        return asdict(self)


def run_soak_job(job: SoakJob) -> JobResult:
    """Run a soak; `metrics` are its `SoakOutcome`."""
    start = time.perf_counter()
    soak = Soak(job.setup(), job.seed)
    try:
        outcome = soak.run(3600.0 * job.hours)
    finally:
        soak.close()
    metrics = {**vars(outcome), 'episodes': dict(outcome.episodes),
               'counts': dict(outcome.counts), 'minutes': [*map(asdict, outcome.minutes)]}
    return JobResult(finite(metrics), {}, time.perf_counter() - start)
