"""Jobs that kill whatever runs them; in a module that workers can import."""

from dataclasses import dataclass
import os
from pathlib import Path
import signal
import time

from multicontact_control.experiment.study.jobs import JobResult
from multicontact_control.process import THREAD_VARIABLES


@dataclass(frozen=True)
class KillJob:
    """
    A piece of work that kills its worker some times before it gets done.

    It does so once the files `after` are there, e.g. the results of others.
    """

    folder: str
    number: int
    deaths: int = 0
    after: tuple[str, ...] = ()

    def key(self):
        return f'job{self.number}'

    def describe(self):
        return {'number': self.number}


def kill_task(job):
    """Note the start, wait a little, and die by SIGKILL as often as the job says."""
    (Path(job.folder) / f'{job.number}-{os.getpid()}-{time.monotonic_ns()}').touch()
    time.sleep(0.02)
    if len(starts(job)) <= job.deaths:
        while not all(Path(path).exists() for path in job.after):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGKILL)
    return JobResult({'number': job.number, 'environment': {
        name: os.environ.get(name) for name in THREAD_VARIABLES}}, {}, 0.02)


def starts(job):
    return list(Path(job.folder).glob(f'{job.number}-*'))


def make_jobs(tmp_path, deaths):
    notes = tmp_path / 'notes'
    notes.mkdir()
    return [KillJob(str(notes), number, count) for number, count in enumerate(deaths)]
