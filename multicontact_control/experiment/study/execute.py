"""Run every job that is not finished yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Generic

from multicontact_control.errors import RunError
from multicontact_control.experiment.compilation import ensure_compiled
from multicontact_control.experiment.display import count_bar
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.executors import Executor, LocalExecutor, LostJob
from multicontact_control.experiment.study.jobs import JobResult, JobT
from rich.console import Console


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
