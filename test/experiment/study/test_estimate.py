"""How long a matrix is said to take."""

from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.estimate import Estimate, estimate_time
from multicontact_control.experiment.study.jobs import job_of, JobResult
import pytest

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
