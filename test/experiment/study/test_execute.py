"""Jobs: their keys, their kept results, and what runs them."""

import os
import pickle

from mortal_jobs import MortalJob, run_mortal
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.study import jobs as jobs_module
from multicontact_control.experiment.study.cache import JobCache, prepare_job_folder
from multicontact_control.experiment.study.execute import dask_client, run_jobs, WORKER_DIED
from multicontact_control.experiment.study.jobs import job_of, JobResult
from multicontact_control.experiment.study.measure import measure_run
from multicontact_control.experiment.study.presets.faults.jobs import FaultJob, run_fault_job
import numpy as np
import pytest

SHORT = [job_of('step', 'rigid', seed, duration=1.6) for seed in range(3)]


def seeds(count=3):
    return [job_of('quick', 'rigid', seed) for seed in range(count)]


class Task:
    """Note which jobs are run, and return their seeds."""

    def __init__(self, fails_at=None):
        self.ran, self.fails_at = [], fails_at

    def __call__(self, job):
        if job.seed == self.fails_at:
            raise KeyboardInterrupt
        self.ran.append(job.seed)
        return JobResult({'seed': job.seed}, {'series': np.full((3, 2), float(job.seed))}, 0.5)


def test_key_changes_with_all_that_changes_the_outcome():
    variants = [
        job_of('quick', 'rigid', 0), job_of('quick', 'rigid', 1), job_of('quick', 'puma', 0),
        job_of('disturbance', 'rigid', 0), job_of('quick', 'rigid', 0, duration=5.0),
        job_of('quick', 'rigid', 0, noise_estimator={'estimator': 'fixed'}),
        job_of('quick', 'rigid', 0, controller={'force': {'damping_rate': 30.0}}),
        job_of('quick', 'rigid', 0, plant_overrides={'actuator_delay_ticks': 2}),
        job_of('quick', 'rigid', 0, scenario_overrides={'reference': {
            'approach': {'speed': 0.03}}}),
        job_of('quick', 'rigid', 0, supervised=True)]
    assert len({job.key() for job in variants}) == len(variants)
    assert variants[0].key() == pickle.loads(pickle.dumps(variants[0])).key()


def test_key_is_that_of_the_values_and_not_of_how_they_were_given():
    given = job_of('quick', 'rigid', 0, controller={'force': {'damping_rate': 100.0}})
    assert given.key() == job_of('quick', 'rigid', 0).key()
    assert given.key() == job_of('quick', 'rigid', 0, preset='best').key()
    assert given.key() != job_of('quick', 'rigid', 0, preset='paper').key()


def test_key_changes_with_the_sources(monkeypatch):
    before = job_of('quick', 'rigid', 0).key()
    monkeypatch.setattr(jobs_module, 'code_stamp', lambda: 'other code')
    assert job_of('quick', 'rigid', 0).key() != before


def test_jobs_run_once_and_again_only_if_their_result_is_not_whole(tmp_path):
    first, second = Task(), Task()
    keys = run_jobs([*seeds(), seeds()[0]], tmp_path, first, workers=1).keys
    assert first.ran == [0, 1, 2]
    cells = JobCache(tmp_path).folder
    traces, record = (cells / f'{keys[seeds()[1]]}.npz', cells / f'{keys[seeds()[2]]}.json')
    traces.write_bytes(traces.read_bytes()[:-20])
    record.write_text(record.read_text()[:40])
    run = run_jobs(seeds(4), tmp_path, second, workers=1)
    assert second.ran == [1, 2, 3]
    for job in seeds(4):
        result = run.result(job)
        assert (result.metrics, result.wall_time) == ({'seed': job.seed}, 0.5)
        np.testing.assert_array_equal(result.traces['series'], np.full((3, 2), job.seed))


def test_results_before_an_interruption_are_kept(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_jobs(seeds(), tmp_path, Task(fails_at=2), workers=1)
    later = Task()
    run = run_jobs(seeds(), tmp_path, later, workers=1)
    assert later.ran == [2]
    (JobCache(tmp_path).folder / f'{run.keys[seeds()[0]]}.json').unlink()
    with pytest.raises(RunError, match='expected a finished job'):
        run.result(seeds()[0])


def test_folder_keeps_other_files_and_drops_results_on_request(tmp_path):
    cache = JobCache(tmp_path)
    cache.save('a', seeds()[0], JobResult({'x': None}, {}, 0.5))
    prepare_job_folder(tmp_path, overwrite=False)
    assert cache.load('a') == JobResult({'x': None}, {}, 0.5)
    prepare_job_folder(tmp_path, overwrite=True)
    assert cache.load('a') is None
    other = tmp_path / 'other'
    other.mkdir()
    (other / 'notes.txt').write_text('mine')
    with pytest.raises(ConfigError, match='^out: '):
        prepare_job_folder(other, overwrite=True)
    prepare_job_folder(other, overwrite=False, results=['notes.txt'])
    assert (other / 'notes.txt').read_text() == 'mine'


@pytest.mark.slow
def test_processes_give_the_same_results_as_this_one(tmp_path):
    here = run_jobs(SHORT, tmp_path / 'here', measure_run, workers=1)
    there = run_jobs(SHORT, tmp_path / 'there', measure_run, workers=2)
    for job in SHORT:
        assert here.result(job).metrics == there.result(job).metrics
        np.testing.assert_equal(here.result(job).traces, there.result(job).traces)


def test_dead_worker_ends_the_run_and_keeps_what_is_finished(tmp_path):
    jobs = [MortalJob(number) for number in range(4)]
    with pytest.raises(RunError, match=f'^{WORKER_DIED}$'):
        run_jobs([*jobs, MortalJob(9, deadly=True)], tmp_path, run_mortal, workers=2)
    run = run_jobs([*jobs, MortalJob(9)], tmp_path, run_mortal, workers=2)
    for job in jobs:
        assert run.metrics(job)['process'] != os.getpid()
        assert run.metrics(job)['threads'] == '1'


@pytest.mark.nightly
def test_cluster_gives_the_same_results_and_ends_with_a_dead_worker(tmp_path, monkeypatch):
    distributed = pytest.importorskip('distributed')
    import dask

    faults = [FaultJob('rigid', 'approach', 0, (('nan', 'wrench', seed),)) for seed in (1, 2)]
    dask.config.set({'distributed.scheduler.allowed-failures': 0})
    with distributed.LocalCluster(2, threads_per_worker=2, dashboard_address=None) as cluster, \
            dask_client(cluster.scheduler_address) as client:
        for jobs, task in ((SHORT, measure_run), (faults, run_fault_job)):
            here = run_jobs(jobs, tmp_path / 'here', task, workers=1)
            there = run_jobs(jobs, tmp_path / 'there', task, client=client)
            assert [here.metrics(job) for job in jobs] == [there.metrics(job) for job in jobs]
        with pytest.raises(RunError, match=f'^{WORKER_DIED}$'):
            run_jobs([MortalJob(0, deadly=True)], tmp_path, run_mortal, client=client)
        monkeypatch.setattr(MortalJob, 'key', lambda self: 'of other code')
        with pytest.raises(RunError, match='other code'):
            run_jobs([MortalJob(1)], tmp_path, run_mortal, client=client)
