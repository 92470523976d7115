"""Tuning: what is tried, what counts as best, and what is written."""

from contextlib import nullcontext
from dataclasses import replace

from multicontact_control.config import read_yaml
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.executors import LocalExecutor
from multicontact_control.experiment.study.jobs import JobResult
from multicontact_control.experiment.study.presets.laws.jobs import LawJob
from multicontact_control.experiment.study.presets.tune import study as tuning
from multicontact_control.experiment.study.presets.tune.study import (
    cost,
    read_ranges,
    SCALES,
    TuneStudy,
)
from multicontact_control.experiment.study.study import run_study, StudyOptions
from multicontact_control.force.laws import LAWS
from multicontact_control.paths import config_dir
import pytest


def test_every_law_has_its_ranges_and_all_of_them_are_acceptable():
    assert set(read_yaml(config_dir() / 'tuning.yaml')) == set(LAWS)
    for law in LAWS:
        jobs = TuneStudy(law).jobs()
        assert len(jobs) == len(set(jobs)) > 1
        assert {job.seed for job in jobs} == {0}
        for name in read_ranges(law):  # the ends of each range
            values = sorted({dict(job.settings)[name] for job in jobs}, key=str)
            for value in (values[0], values[-1]):
                next(job for job in jobs if dict(job.settings)[name] == value).setup()


def test_unknown_law_is_named():
    with pytest.raises(ConfigError, match="law: expected one of aob, .*'pid'"):
        TuneStudy('pid').check()


def test_cost_adds_figures_and_refuses_what_is_not_stable():
    row = {'stable': 1, 'runs': 1, **SCALES}
    assert cost(row) == pytest.approx(len(SCALES))
    assert cost(row | {'stable': 0}) == float('inf')
    assert cost(row | {'rise_s': None}) == float('inf')


def test_table_says_why_a_combination_has_no_cost(tmp_path):
    row = {'settings': {'a.b': 1.0}, 'stable': 1, 'runs': 1, **SCALES}
    page = TuneStudy('dob').page([
        {**row, 'cost': 6.0}, {**row, 'cost': None, 'rise_s': None},
        {**row, 'cost': None, 'stable': 0, 'rise_s': None}], tmp_path)
    assert [line.cells[0] for line in page.sections[0].listing.lines] == [
        '6.00', 'without rise_s', 'not stable']


def test_combination_with_a_lost_run_is_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, 'read_ranges', lambda law: {
        'controller.force.damping_rate': [40.0, 100.0]})
    study = TuneStudy('dob', ('rigid', 'puma'))
    jobs = study.jobs()
    cache, metrics = JobCache(tmp_path), {
        'stable': False, 'why': '', 'oscillates': True, 'activity_nm': 0.1, 'neighbour_n': None,
        'contacts': {'table': {'rest_rms_n': 0.1, 'moving_rms_n': 0.1, 'push_peak_n': 0.1,
                               'push_off_s': 0.1, 'steps': []}}}
    for job in jobs:
        cache.save(job.key(), job, JobResult(metrics, {}, 0.1))
    run = JobRun(tmp_path, cache, {job: job.key() for job in jobs}, {jobs[0]: 'died'})
    assert [row['settings'] for row in study.content(run)] == [dict(jobs[-1].settings)]
    lost = replace(run, lost={jobs[0]: 'died', jobs[-1]: 'died'})
    with pytest.raises(RunError, match='tune: expected a combination .*found 2 of 4 jobs lost'):
        study.content(lost)


class Noting(LocalExecutor):
    """Notes what it is given to run."""

    def __init__(self):
        super().__init__(1)
        self.given = []

    def results(self, task, jobs, notify):
        self.given += jobs
        yield from super().results(task, jobs, notify)


@pytest.fixture(scope='module')
def tuned(tmp_path_factory):
    """Choose between two damping rates, twice in one folder; return it and what each found."""
    folder, executor = tmp_path_factory.mktemp('tune'), Noting()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, 'read_ranges', lambda law: {
            'controller.force.damping_rate': [40.0, 100.0]})
        patch.setattr(tuning, 'JUDGED_ON', (1, 2))
        patch.setattr(StudyOptions, 'executor', lambda self: nullcontext(executor))
        found = [(run_study(TuneStudy('dob', ('rigid',)), StudyOptions(folder)),
                  [job.seed for job in executor.given]) for _ in range(2)]
    return folder, found


@pytest.mark.slow
def test_runs_on_other_seeds_are_jobs_like_the_others(tuned):
    """Whoever runs the jobs runs them too, and what is finished is not run again."""
    (first, given), again = tuned[1]
    assert given == [0, 0, 1, 2]
    assert first[0]['judged'][0]['runs'] == 2
    assert again == (first, given)


@pytest.mark.slow
def test_best_combination_is_written_and_judged_on_other_seeds(tuned):
    folder, ((content, _), _) = tuned
    costs = [row['cost'] for row in content if row['cost'] is not None]
    assert costs == sorted(costs)
    best = content[0]
    assert best['judged'][0]['stable'] == 2
    setup = resolve('quick', preset=str(folder / 'dob.yaml'))
    assert setup.controller.force.law == 'dob'
    assert setup.controller.force.damping_rate == best['settings'][
        'controller.force.damping_rate']
    job = LawJob('laws/dob', 'rigid', 0, 'task')
    assert replace(job, seed=1).setup().seed == 1
