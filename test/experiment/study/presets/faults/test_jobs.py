"""Faults as jobs: what one gives does not depend on what ran before, nor on where."""

from multicontact_control.experiment.study.execute import run_jobs
from multicontact_control.experiment.study.executors import DaskExecutor
from multicontact_control.experiment.study.presets.faults.jobs import (
    FaultJob,
    PHASE_TIMES,
    run_fault_job,
)
import pytest


@pytest.mark.slow
def test_fault_does_not_depend_on_those_before_it():
    """A world that others have used before gives the same rows as a fresh one."""
    job = FaultJob('rigid', 'approach', 0, (('nan', 'wrench', 1), ('biased', 'wrench', 5)))
    later = FaultJob('rigid', 'rest', 0, (('nan', 'wrench', 1),))
    fresh = [run_fault_job(piece).metrics for piece in (later, job)]
    assert [run_fault_job(piece).metrics for piece in (job, later)] == fresh[::-1]


@pytest.mark.slow
def test_faults_happen_on_a_cluster_as_they_do_here(tmp_path, dask_cluster):
    """Workers of Dask are not allowed to have children of `multiprocessing`."""
    jobs = [FaultJob('rigid', 'approach', 0, (('nan', 'wrench', seed),)) for seed in (1, 2)]
    with DaskExecutor(dask_cluster.address) as executor:
        run = run_jobs(jobs, tmp_path, run_fault_job, executor=executor)
    assert [run.result(job).metrics for job in jobs] == [
        run_fault_job(job).metrics for job in jobs]
    assert all(run.result(job).metrics['rows'][0]['reaction'] == 'hold' for job in jobs)


def test_wall_time_grows_with_the_faults():
    one, three = (FaultJob('rigid', 'rest', 0, (('nan', 'wrench', 1),) * n) for n in (1, 3))
    assert three.simulated_time() - one.simulated_time() == pytest.approx(2 * 600 / 500)
    assert one.simulated_time() > PHASE_TIMES['rest']
