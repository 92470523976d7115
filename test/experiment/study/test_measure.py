from multicontact_control.experiment.study.execute import run_jobs
from multicontact_control.experiment.study.executors import LocalExecutor
from multicontact_control.experiment.study.jobs import job_of
from multicontact_control.experiment.study.measure import measure_run

# Stretched out, where nothing damps what a singular posture asks for: there is no first torque.
SINGULAR = {'plant_overrides': {'home': [0.0] * 6},
            'controller': {'limits': {'singular_mobility': 0.0}}}


def test_run_that_ends_at_once_counts_as_unstable_and_does_not_end_the_study(tmp_path):
    jobs = [job_of('disturbance', 'rigid', seed, duration=duration, **changes)
            for seed, duration, changes in ((0, 2.0, SINGULAR), (1, 1.7, {}))]
    run = run_jobs(jobs, tmp_path, measure_run, executor=LocalExecutor(1))
    at_once, whole = (run.result(job).metrics for job in jobs)
    assert run.lost == {}
    assert at_once['summary']['stable'] is False and at_once['evidence']['stable'] is False
    assert at_once['summary']['ended_early'].startswith('tick 0: J M^-1 J^T')
    assert at_once['final_error_share'] is None
    assert whole['summary']['ended_early'] is None
