"""Run every job that is not finished yet, and tell before how long that will take."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
import time
from typing import Generic

from multicontact_control.errors import RunError
from multicontact_control.experiment.compilation import ensure_compiled
from multicontact_control.experiment.display import count_bar
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.executors import Executor, LocalExecutor, LostJob
from multicontact_control.experiment.study.jobs import Job, JobResult, JobT
from multicontact_control.wording import counted, lasting
from rich.console import Console

START_UP = 3.0  # s, to start a pool of workers
PROBE = 1.5  # s of simulated time that a plant's speed is taken from


@dataclass(frozen=True)
class JobRun(Generic[JobT]):
    """
    What came of the jobs of a study.

    Attributes
    ----------
    folder, cache
        Of the study, and in it where the results are.
    keys
        The key of every job.
    lost
        Why a job has no result, for those that have none.

    """

    folder: Path
    cache: JobCache
    keys: Mapping[JobT, str]
    lost: Mapping[JobT, str]

    def kept(self, jobs: Iterable[JobT]) -> list[JobT]:
        """Return which of some jobs were not lost."""
        return [job for job in jobs if job not in self.lost]

    def result(self, job: JobT) -> JobResult:
        """Return the result of a job; RunError if it has none."""
        result = self.cache.load(self.keys[job])
        if result is None:
            why = self.lost.get(job, 'it was changed meanwhile')
            raise RunError(f'{self.cache.folder}/{self.keys[job]}: expected a finished job: '
                           f'{why}')
        return result


def run_jobs(
    jobs: Sequence[JobT], folder: Path, task: Callable[[JobT], JobResult], *,
    executor: Executor | None = None, console: Console | None = None, title: str = 'jobs',
) -> JobRun[JobT]:
    """
    Run every job that is not finished yet, one that comes twice once.

    Parameters
    ----------
    jobs, folder
        Of a study.
    task
        What a job is run with: an importable function.
    executor
        Who runs them; all cores of this machine if not given.
    console, title
        Where the progress bar is shown, with the time left, and what is said beside it.

    Raises
    ------
    ConfigError
        If a job's configuration is not acceptable, before anything is run.

    """
    cache = JobCache(folder)
    keys = {job: job.key() for job in jobs}
    todo = list({key: job for job, key in keys.items() if not cache.finished(key)}.values())
    lost: dict[str, str] = {}
    if todo:
        ensure_compiled(console)  # here once, not in every worker at once
    with count_bar(console) as progress:
        bar = progress.add_task(title, total=len(set(keys.values())),
                                completed=len(set(keys.values())) - len(todo))

        def notify(text: str) -> None:
            progress.console.print(f'{title}: {text}', highlight=False, markup=False)

        if todo:
            work = (executor or LocalExecutor()).results(task, todo, notify)
            with closing(work) as outcomes:
                for job, outcome in outcomes:
                    if isinstance(outcome, LostJob):
                        lost[keys[job]] = outcome.reason
                    else:
                        cache.save(keys[job], job, outcome)
                    progress.advance(bar)
    return JobRun(folder, cache, keys,
                  {job: lost[key] for job, key in keys.items() if key in lost})


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
        known = f'{counted(self.runs, what)}, {self.finished} of them finished before'
        if self.seconds is None or not self.todo:
            return f'{known}; {workers} at once'
        return (f'{known}; the other {self.todo} will take about {lasting(self.seconds)} with '
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
    from multicontact_control.experiment.closed_loop import run_in_process

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
