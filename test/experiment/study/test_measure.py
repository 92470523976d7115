from multicontact_control.experiment.study.execute import run_jobs
from multicontact_control.experiment.study.jobs import job_of
from multicontact_control.experiment.study.measure import measure_run

# Stretched out, where nothing damps what a singular posture asks for: there is no first torque.
SINGULAR = {'plant_overrides': {'home': [0.0] * 6},
            'controller': {'limits': {'singular_mobility': 0.0}}}


def test_run_that_ends_at_once_counts_as_unstable_and_does_not_end_the_study(tmp_path):
    jobs = [job_of('disturbance', 'rigid', seed, duration=1.7, **changes)
            for seed, changes in enumerate((SINGULAR, {}))]
    run = run_jobs(jobs, tmp_path, measure_run, workers=1)
    at_once, whole = map(run.metrics, jobs)
    assert at_once['summary']['stable'] is False and at_once['evidence']['stable'] is False
    assert at_once['summary']['ended_early'].startswith('tick 0: ')
    assert at_once['final_error_share'] is None
    assert whole['summary']['ended_early'] is None
