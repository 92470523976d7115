"""Processes of this machine and workers of a real Dask scheduler, which get killed."""

from dataclasses import replace
import os
import re
import signal
import socket
import sys
import time

from mortal_jobs import kill_task, make_jobs, starts
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.execute import run_jobs
from multicontact_control.experiment.study.executors import DaskExecutor, LocalExecutor
import pytest
from rich.console import Console
from ros_graph import wait_for


def run(tmp_path, jobs, executor):
    with (tmp_path / 'terminal.txt').open('w') as file:
        done = run_jobs(jobs, tmp_path / 'out', kill_task, executor=executor,
                        console=Console(file=file, width=200))
    return done, (tmp_path / 'terminal.txt').read_text()


def test_killed_worker_loses_nothing(tmp_path):
    """The pool is made anew; what had a result before is not run again."""
    jobs = make_jobs(tmp_path, [0] * 9 + [1] + [0] * 10)
    # One worker may be on its first job for as long as the other takes for all before the deadly.
    cells = JobCache(tmp_path / 'out').folder
    jobs[9] = replace(jobs[9], after=tuple(
        str(cells / f'{job.key()}.json') for job in jobs[:9]))
    done, text = run(tmp_path, jobs, LocalExecutor(2))
    assert done.lost == {}
    assert [done.result(job).metrics['number'] for job in jobs] == list(range(20))
    died = re.search(r'a worker died: (\d+) unfinished runs to be started again', text)
    assert died, text
    assert [len(starts(job)) for job in jobs[:10]] == [1] * 9 + [2]
    assert sum(len(starts(job)) for job in jobs) <= 20 + int(died[1])


def test_job_that_always_kills_its_worker_is_given_up_alone(tmp_path):
    jobs = make_jobs(tmp_path, [0, 0, 99, 0, 0, 0])
    done, text = run(tmp_path, jobs, LocalExecutor(2))
    assert list(done.lost) == [jobs[2]]
    assert len(starts(jobs[2])) == 3
    assert 'given up' in text
    cache = JobCache(tmp_path / 'out')
    assert [cache.finished(job.key()) for job in jobs] == [True, True, False, True, True, True]


def test_workers_have_one_numerical_thread(tmp_path):
    jobs = make_jobs(tmp_path, [0, 0])
    done, _ = run(tmp_path, jobs, LocalExecutor(2))
    pids = {path.name.split('-')[1] for job in jobs for path in starts(job)}
    assert str(os.getpid()) not in pids
    for job in jobs:
        assert set(done.result(job).metrics['environment'].values()) == {'1'}


def test_one_job_runs_in_this_process(tmp_path):
    jobs = make_jobs(tmp_path, [0, 0])
    run(tmp_path, jobs, LocalExecutor(1))
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


@pytest.mark.slow
def test_killed_workers_lose_nothing_and_a_deadly_job_is_given_up(tmp_path, dask_cluster):
    jobs = make_jobs(tmp_path, [0] * 6 + [1] + [0] * 6 + [99] + [0] * 2)
    with DaskExecutor(dask_cluster.address) as executor:
        assert executor.workers == 2
        done, text = run(tmp_path, jobs, executor)
    assert done.lost == {jobs[13]: 'the workers that were to run it died'}
    assert 'run by itself' in text
    for job in jobs:
        if job is not jobs[13]:
            assert done.result(job).metrics['number'] == job.number
    assert len(starts(jobs[6])) >= 2  # more if a result dies with a worker before it is taken
    workers = {path.name.split('-')[1] for job in jobs for path in starts(job)}
    assert len(workers) >= 2


@pytest.mark.slow
def test_results_that_die_with_their_workers_before_they_are_taken_are_made_anew(
    tmp_path, dask_cluster,
):
    jobs = make_jobs(tmp_path, [0] * 12)
    with DaskExecutor(dask_cluster.address) as executor:
        results = executor.results(kill_task, jobs, print)
        numbers = [next(results)[1].metrics['number']]
        wait_for(lambda: all(starts(job) for job in jobs), 'all jobs at work')
        time.sleep(1.0)  # all have a result, and the client has been told
        for pid in {int(path.name.split('-')[1]) for job in jobs for path in starts(job)}:
            os.kill(pid, signal.SIGKILL)
        wait_for(lambda: executor.workers == 0, 'no worker left')  # until there are new ones
        numbers += [outcome.metrics['number'] for _, outcome in results]
    assert sorted(numbers) == list(range(12))
    assert max(len(starts(job)) for job in jobs) == 2


@pytest.mark.slow
def test_worker_with_other_code_is_refused(tmp_path, dask_cluster, monkeypatch):
    """The key stands for code and configuration: a worker must come to the same."""
    jobs = make_jobs(tmp_path, [0])
    monkeypatch.setattr(type(jobs[0]), 'key', lambda self: 'of other code')
    with DaskExecutor(dask_cluster.address) as executor:
        with pytest.raises(RunError, match='other code, libraries or configuration files'):
            run(tmp_path, jobs, executor)
    assert starts(jobs[0]) == []


@pytest.mark.slow
def test_scheduler_that_dies_ends_the_run_with_one_line(tmp_path, dask_cluster):
    """What came before is kept."""
    jobs = make_jobs(tmp_path, [0] * 200)
    seen = []
    with pytest.raises(RunError, match='the Dask scheduler is gone'):
        with DaskExecutor(dask_cluster.address) as executor:
            for job, _ in executor.results(kill_task, jobs, print):
                if not seen:
                    dask_cluster.scheduler.kill()
                seen.append(job)
    assert 1 <= len(seen) < 200


def test_address_that_does_not_answer_is_refused(monkeypatch):
    pytest.importorskip('distributed')
    monkeypatch.setattr('multicontact_control.experiment.study.executors.CONNECT_TIMEOUT', 1.0)
    with socket.socket() as unused:  # bound, so that nobody else answers; and not listening
        unused.bind(('127.0.0.1', 0))
        address = f'tcp://127.0.0.1:{unused.getsockname()[1]}'
        with pytest.raises(ConfigError, match=f'dask: expected .* answers.*found {address}'):
            DaskExecutor(address)


@pytest.mark.parametrize('address', ['nonsense://x:1', 'localhost:notaport', ''])
def test_address_that_is_none_is_refused(address, monkeypatch):
    pytest.importorskip('distributed')
    monkeypatch.setattr('multicontact_control.experiment.study.executors.CONNECT_TIMEOUT', 1.0)
    with pytest.raises(ConfigError, match='dask: expected the address'):
        DaskExecutor(address)


def test_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with pytest.raises(RunError, match=r'needs `distributed`.*multicontact_control\[dask\]'):
        DaskExecutor('tcp://127.0.0.1:1')
