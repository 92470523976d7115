"""How long a study will take."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
import time

from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.jobs import Job

START_UP = 3.0  # s, to start a pool of workers
PROBE = 1.5  # s of simulated time that a plant's speed is taken from


@dataclass(frozen=True)
class Estimate:
    """All runs, those that are finished, and the wall time of the others [s] if it is known."""

    runs: int
    finished: int
    seconds: float | None

    @property
    def todo(self) -> int:
        """Return how many runs are not finished."""
        return self.runs - self.finished

    def sentence(self, workers: int, what: str = 'runs') -> str:
        """Return all this in words; `what` there are so many of."""
        known = f'{self.runs} {what}, {self.finished} of them finished before'
        if self.seconds is None or not self.todo:
            return f'{known}; {workers} at once'
        return (f'{known}; the other {self.todo} will take about {_words(self.seconds)} with '
                f'{workers} at once')


def estimate_time(
    jobs: Iterable[Job], folder: Path, workers: int, *, probe: bool = True, anew: bool = False,
) -> Estimate:
    """
    Return how long the jobs that are not finished will take.

    From the finished jobs of the same plant, or with `probe` from a short run of it. Finished
    jobs that are to be run `anew` still tell the speed.
    """
    cache = JobCache(folder)
    known: dict[str, list[float]] = {}  # wall time for a simulated second, by plant
    todo: dict[str, list[float]] = {}  # simulated seconds
    examples: dict[str, Job] = {}
    keyed = {job.key(): job for job in jobs}
    for key, job in keyed.items():
        result, duration = cache.load(key), job.simulated_time()
        if result is None or anew:
            todo.setdefault(job.plant, []).append(duration)
            examples.setdefault(job.plant, job)
        if result is not None:
            known.setdefault(job.plant, []).append(result.wall_time / duration)
    left = sum(map(len, todo.values()))
    if not probe and not todo.keys() <= known.keys():
        return Estimate(len(keyed), len(keyed) - left, None)
    total = sum(
        sum(durations) * (median(known[plant]) if plant in known else _probe(examples[plant]))
        for plant, durations in todo.items())
    start_up = START_UP if left > 1 and workers > 1 else 0.0
    return Estimate(len(keyed), len(keyed) - left, total / min(workers, max(left, 1)) + start_up)


def _probe(job: Job) -> float:
    """Return the wall time for a simulated second of a job, from its beginning."""
    # Only here: who needs no probe needs neither kernels nor simulator.
    from multicontact_control.experiment.compilation import ensure_compiled
    from multicontact_control.experiment.loop import run_in_process

    ensure_compiled()
    setup = job.setup()
    duration = min(PROBE, setup.scenario.duration)
    short = replace(setup, scenario=setup.scenario.model_copy(update={'duration': duration}))
    try:
        run_in_process(short, supervised=job.supervised)
        start = time.perf_counter()
        run_in_process(short, supervised=job.supervised)
    except Exception:  # whatever ails this job comes out when it is run
        return 0.0
    return (time.perf_counter() - start) / duration


def _words(seconds: float) -> str:
    if seconds < 90.0:
        return f'{seconds:.0f} s'
    if seconds < 5400.0:
        return f'{seconds / 60.0:.1f} min'
    return f'{seconds / 3600.0:.1f} h'
