"""Processes of this machine, and what happens when one is killed."""

import os

from mortal_jobs import kill_task, make_jobs, starts
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.execute import run_jobs
from multicontact_control.experiment.study.local import LocalExecutor
import pytest
from rich.console import Console


def run(tmp_path, jobs, workers=2):
    with (tmp_path / 'terminal.txt').open('w') as file:
        done = run_jobs(jobs, tmp_path / 'out', kill_task, executor=LocalExecutor(workers),
                        console=Console(file=file, width=200))
    return done, (tmp_path / 'terminal.txt').read_text()


def test_killed_worker_loses_nothing(tmp_path):
    """The pool is made anew; what had a result before is not run again."""
    jobs = make_jobs(tmp_path, [0] * 9 + [1] + [0] * 10)
    done, text = run(tmp_path, jobs)
    assert done.lost == {}
    assert [done.result(job).metrics['number'] for job in jobs] == list(range(20))
    assert 'a worker died' in text
    assert len(starts(jobs[9])) == 2
    assert sum(len(starts(job)) for job in jobs) <= 20 + 4  # at most what was given out
    assert len(starts(jobs[0])) == 1


def test_job_that_always_kills_its_worker_is_given_up_alone(tmp_path):
    jobs = make_jobs(tmp_path, [0, 0, 99, 0, 0, 0])
    done, text = run(tmp_path, jobs)
    assert list(done.lost) == [jobs[2]]
    assert len(starts(jobs[2])) == 3
    assert 'given up' in text
    cache = JobCache(tmp_path / 'out')
    assert [cache.finished(job.key()) for job in jobs] == [True, True, False, True, True, True]


def test_workers_have_one_numerical_thread(tmp_path):
    jobs = make_jobs(tmp_path, [0, 0])
    done, _ = run(tmp_path, jobs)
    pids = {path.name.split('-')[1] for job in jobs for path in starts(job)}
    assert str(os.getpid()) not in pids
    for job in jobs:
        assert set(done.result(job).metrics['environment'].values()) == {'1'}


def test_one_job_runs_in_this_process(tmp_path):
    jobs = make_jobs(tmp_path, [0, 0])
    run(tmp_path, jobs, workers=1)
    assert {path.name.split('-')[1] for job in jobs for path in starts(job)} == {
        str(os.getpid())}


def task_that_no_worker_can_import(job):
    """Lie in a module that only pytest knows."""


def test_work_that_cannot_be_handed_over_is_said_to_be_so(tmp_path):
    jobs = make_jobs(tmp_path, [0, 0])
    with pytest.raises(RunError, match='the workers cannot run anything'):
        list(LocalExecutor(2).results(task_that_no_worker_can_import, jobs, print))


def test_number_of_jobs_is_checked():
    with pytest.raises(ConfigError, match='jobs: expected a whole number >= 0, found -1'):
        LocalExecutor(-1)
