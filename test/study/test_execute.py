"""Jobs: their keys, and what runs them."""

from dataclasses import replace
import os
import pickle

from mortal_jobs import MortalJob
from multicontact_control.errors import RunError
from multicontact_control.study import jobs as jobs_module
from multicontact_control.study.jobs import prepare_folder, run_jobs, RunJob
from multicontact_control.study.presets.faults import FaultJob
import pytest


def by_key(jobs):
    return {job.key(): job for job in jobs}


def job_of(**arguments):
    return RunJob({'scenario': 'quick', 'plant': 'rigid', 'seed': 0, **arguments})


def test_key_changes_with_all_that_changes_the_outcome_and_with_nothing_else(
    monkeypatch,
):
    variants = [
        job_of(),
        job_of(seed=1),
        job_of(plant='puma'),
        job_of(scenario='disturbance'),
        job_of(duration=5.0),
        job_of(preset='paper'),
        job_of(noise_estimator={'estimator': 'fixed'}),
        job_of(plant_overrides={'actuator_delay_ticks': 2}),
        job_of(scenario_overrides={'reference': {'approach': {'speed': 0.03}}}),
        replace(job_of(), supervised=True),
        replace(job_of(), surface_gone=(5.0, 6.0)),
    ]
    keys = [job.key() for job in variants]
    assert len(set(keys)) == len(variants)
    key = keys[0]
    for same in (
        pickle.loads(pickle.dumps(job_of())),
        job_of(controller={'force': {'damping_rate': 100.0}}),
        job_of(preset='best'),
    ):
        assert same.key() == key
    monkeypatch.setattr(jobs_module, 'hash_code', lambda: 'other code')
    assert job_of().key() != key


def test_dead_worker_ends_the_run_and_keeps_what_is_finished(tmp_path):
    prepare_folder(tmp_path, overwrite=False)
    jobs = [MortalJob(number) for number in range(4)]
    with pytest.raises(RunError, match=f'^{jobs_module.WORKER_DIED}$'):
        run_jobs(by_key([*jobs, MortalJob(9, deadly=True)]), tmp_path, workers=2)
    results = run_jobs(by_key([*jobs, MortalJob(9)]), tmp_path, workers=2)
    for job in jobs:
        result = results[job.key()]
        assert result['process'] != os.getpid()
        assert result['threads'] == '1'
    with pytest.raises(RunError, match='other code'):
        run_jobs({'job of other code': MortalJob(1)}, tmp_path, workers=1)


@pytest.mark.nightly
def test_processes_and_cluster_give_the_results_of_this_process(tmp_path):
    distributed = pytest.importorskip('distributed')
    fault = FaultJob('quick', 'rigid', 'approach', 0, (((('nan', 'wrench'),), 1),))
    jobs = by_key([job_of(scenario='step', duration=1.6), fault])

    def run_in(name, **options):
        folder = tmp_path / name
        prepare_folder(folder, overwrite=False)
        return run_jobs(jobs, folder, **options)

    here = run_in('here', workers=1)
    assert run_in('there', workers=2) == here
    with (
        distributed.LocalCluster(
            2, threads_per_worker=2, dashboard_address=None
        ) as cluster,
        jobs_module.dask_client(cluster.scheduler_address) as client,
    ):
        assert run_in('cluster', client=client) == here
