from dataclasses import dataclass, field
import json

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.execute import Estimate, estimate_time, run_jobs
from multicontact_control.experiment.study.executors import LocalExecutor, LostJob
from multicontact_control.experiment.study.jobs import job_of, JobResult
from multicontact_control.experiment.study.measure import measure_run
from multicontact_control.files import finite
import numpy as np
import pytest


def seed_task(job):
    return JobResult({'seed': job.seed}, {'series': np.full((3, 2), float(job.seed))}, 0.5)


@dataclass
class CountingExecutor:
    """Runs jobs here, last one first, and remembers them."""

    ran: list = field(default_factory=list)

    def results(self, task, jobs, notify):
        for job in reversed(jobs):
            self.ran.append(job.seed)
            yield job, task(job)


def jobs(count=3):
    return [job_of('quick', 'rigid', seed) for seed in range(count)]


def test_jobs_run_once_and_again_only_what_is_not_whole(tmp_path):
    first = CountingExecutor()
    keys = run_jobs(jobs(), tmp_path, seed_task, executor=first).keys
    assert sorted(first.ran) == [0, 1, 2]
    store = JobCache(tmp_path)
    traces = store.folder / f'{keys[jobs()[1]]}.npz'
    traces.write_bytes(traces.read_bytes()[:-20])
    record = store.folder / f'{keys[jobs()[2]]}.json'
    record.write_text(record.read_text()[:40])
    second = CountingExecutor()
    run_jobs(jobs(4), tmp_path, seed_task, executor=second)
    assert sorted(second.ran) == [1, 2, 3]
    for job in jobs(4):
        result = store.load(job.key())
        assert result.metrics == {'seed': job.seed}
        np.testing.assert_array_equal(result.traces['series'], float(job.seed))


def test_jobs_that_were_finished_before_an_error_are_kept(tmp_path):
    class Failing(CountingExecutor):

        def results(self, task, jobs, notify):
            yield jobs[0], task(jobs[0])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_jobs(jobs(), tmp_path, seed_task, executor=Failing())
    later = CountingExecutor()
    run_jobs(jobs(), tmp_path, seed_task, executor=later)
    assert len(later.ran) == 2


def test_bad_job_is_refused_before_anything_runs(tmp_path):
    executor = CountingExecutor()
    bad = job_of('quick', 'rigid', 0, controller={'force': {'damping_rate': -1.0}})
    with pytest.raises(ConfigError, match='damping_rate'):
        run_jobs([*jobs(), bad], tmp_path, seed_task, executor=executor)
    assert executor.ran == []


def test_lost_job_is_named_and_run_again_the_next_time(tmp_path):
    class Losing(CountingExecutor):

        def results(self, task, jobs, notify):
            for job in jobs:
                yield job, LostJob('out of memory') if job.seed == 1 else task(job)

    run = run_jobs(jobs(), tmp_path, seed_task, executor=Losing())
    assert run.result(jobs()[2]).metrics == {'seed': 2}
    assert run.lost == {jobs()[1]: 'out of memory'}
    with pytest.raises(RunError, match='expected a finished job: out of memory'):
        run.result(jobs()[1])
    later = CountingExecutor()
    assert run_jobs(jobs(), tmp_path, seed_task, executor=later).lost == {}
    assert later.ran == [1]


@pytest.mark.slow
def test_jobs_have_the_same_results_with_any_number_of_workers(tmp_path):
    short = [job_of('step', 'rigid', seed, duration=1.7) for seed in range(3)]
    records = []
    for jobs in (1, 2):
        folder = tmp_path / str(jobs)
        run_jobs(short, folder, measure_run, executor=LocalExecutor(jobs))
        found = [json.loads(path.read_text()) for path in sorted(folder.glob('cells/*.json'))]
        records.append([{**record, 'wall_s': 0.0} for record in found])
    assert len(records[0]) == 3
    assert records[0] == records[1]


def test_finite_leaves_no_number_that_json_has_not():
    assert finite({'a': [float('nan'), 1.0], 'b': (float('inf'), 2)}) == {
        'a': [None, 1.0], 'b': [None, 2]}


CELLS = [job_of('step', 'rigid', seed, duration=duration)
         for seed, duration in enumerate((2.0, 4.0, 10.0))]


def finish(folder, job, wall_time):
    JobCache(folder).save(job.key(), job, JobResult({}, {}, wall_time))


def test_estimate_follows_finished_runs_of_the_plant_and_the_simulated_time(tmp_path):
    """4 s took 2 s of wall time: the other 12 s take 6 s on one worker, 3 s on two."""
    finish(tmp_path, CELLS[1], 2.0)
    one = estimate_time(CELLS, tmp_path, 1)
    assert (one.runs, one.finished, one.todo) == (3, 1, 2)
    assert one.seconds == pytest.approx(6.0)
    two = estimate_time([*CELLS, CELLS[0]], tmp_path, 2, probe=False)
    assert two.todo == 2
    assert two.seconds - one.seconds / 2.0 == pytest.approx(3.0)  # to start the workers


def test_estimate_without_a_probe_of_a_new_plant_says_nothing(tmp_path):
    finish(tmp_path, CELLS[1], 2.0)
    estimate = estimate_time([*CELLS, job_of('step', 'puma', 0)], tmp_path, 1, probe=False)
    assert estimate.seconds is None
    assert estimate.sentence(2) == '4 runs, 1 of them finished before; 2 at once'


def test_probe_tells_the_time_of_a_new_plant(tmp_path):
    assert estimate_time(CELLS[:1], tmp_path, 1).seconds > 0.0


@pytest.mark.parametrize(('seconds', 'words'), [
    (45.0, '45 s'), (600.0, '10.0 min'), (7200.0, '2.0 h')])
def test_estimate_is_told_in_fitting_units(seconds, words):
    assert Estimate(5, 1, seconds).sentence(2) == (
        f'5 runs, 1 of them finished before; the other 4 will take about {words} with 2 at once')
