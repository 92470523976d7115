"""Force laws: their race, what is measured and ranked, and the tuning of their gains."""

from multicontact_control.config import read_yaml
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.study.presets.laws.jobs import (
    DELAY,
    FRICTION,
    LawJob,
    run_law_job,
    STIFFNESS,
    TASK,
    VANISHING,
)
from multicontact_control.experiment.study.presets.laws.study import (
    law_rows,
    LawStudy,
)
from multicontact_control.experiment.study.presets.tune import study as tuning
from multicontact_control.experiment.study.presets.tune.study import cost, SCALES, TuneStudy
from multicontact_control.experiment.study.study import run_study, StudyOptions
from multicontact_control.force.laws import LAWS
from multicontact_control.paths import config_dir
import pytest


def test_grid_has_every_law_in_every_situation():
    jobs = LawStudy().jobs()
    assert len(jobs) == len(set(jobs)) == 9 * 3 * (2 * (2 + 8 + 3) + 3)
    assert {job.seed for job in jobs} == {1, 2, 3}  # tuned on 0
    assert not any(job.situation == FRICTION and job.plant == 'rigid' for job in jobs)


def test_situations_change_the_plant_and_nothing_else():
    plain, stiff, late, rough = (
        LawJob('best', 'puma', 1, situation, value).setup() for situation, value in (
            (TASK, 1.0), (STIFFNESS, 5.0), (DELAY, 3.0), (FRICTION, 4.0)))
    assert {s.stiffness for s in stiff.plant.surfaces.values()} == {30_000.0}
    assert late.plant.actuator_delay_ticks == 3
    assert rough.plant.joint_friction_scale == pytest.approx(
        4.0 * plain.plant.joint_friction_scale)
    assert plain.controller == stiff.controller == late.controller == rough.controller


@pytest.mark.slow
def test_run_measures_task_and_vanishing_surface():
    task = run_law_job(LawJob('best', 'rigid', 1, TASK)).metrics
    assert task['stable'] and task['neighbour_n'] is None
    for contact in task['contacts'].values():
        assert 0.0 < contact['rest_rms_n'] < 0.1
        assert all(0.01 < step['rise_s'] < 0.1 for step in contact['steps'])
        assert contact['push_off_s'] is not None
    gone = run_law_job(LawJob('best', 'rigid', 1, VANISHING)).metrics
    assert 0.1 < gone['neighbour_n'] < 5.0


def metrics(**changes):
    contact = {'rest_rms_n': 0.05, 'moving_rms_n': 0.6, 'push_peak_n': 0.5, 'push_off_s': 0.0,
               'steps': [{'rise_s': 0.03, 'overshoot_percent': 2.0}]}
    return {'stable': True, 'why': '', 'oscillates': False, 'activity_nm': 0.1,
            'neighbour_n': None, 'contacts': {'table': contact, 'board': {**contact, **changes}}}


def rows_of(found):
    jobs = [LawJob(law, 'puma', seed, situation, value)
            for law, seed, situation, value in found]
    return law_rows(jobs, dict(zip(jobs, found.values())).__getitem__)


def test_rows_are_medians_of_the_worse_contact():
    row, = rows_of({('best', seed, TASK, 1.0): metrics(rest_rms_n=error)
                    for seed, error in ((1, 0.1), (2, 0.3), (3, 0.2))})
    assert row['rest_rms_n'] == pytest.approx(0.2)
    assert row['rise_s'] == pytest.approx(0.03)
    assert (row['stable'], row['runs']) == (3, 3)
    row, = rows_of({('best', 1, TASK, 1.0): metrics(push_off_s=None)})
    assert row['push_off_s'] is None


def test_every_law_has_ranges_whose_ends_are_acceptable():
    declared = read_yaml(config_dir() / 'tuning.yaml')
    assert set(declared) == set(LAWS)
    for law, ranges in declared.items():
        tried = TuneStudy(law).jobs()
        assert len(tried) == len(set(tried)) > 1
        assert {job.seed for job in tried} == {0}
        for end in (0, -1):
            settings = tuple((name, values[end]) for name, values in ranges.items())
            next(job for job in tried if job.settings == settings).setup()


def test_cost_adds_figures_and_refuses_what_is_not_stable():
    row = {'stable': 1, 'runs': 1, **SCALES}
    assert cost(row) == pytest.approx(len(SCALES))
    assert cost(row | {'stable': 0}) == float('inf')
    assert cost(row | {'rise_s': None}) == float('inf')


@pytest.mark.slow
def test_best_combination_is_written_judged_on_other_seeds_and_not_run_again(
        tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, 'read_ranges', lambda law: {
        'controller.force.damping_rate': [40.0, 100.0]})
    monkeypatch.setattr(tuning, 'JUDGED_ON', (1,))
    content = run_study(TuneStudy('dob', ('rigid',)), StudyOptions(tmp_path, jobs=1))
    assert content[0]['cost'] <= content[1]['cost']
    assert content[0]['judged'][0]['stable'] == 1
    setup = resolve('quick', preset=str(tmp_path / 'dob.yaml'))
    assert setup.controller.force.law == 'dob'
    assert setup.controller.force.damping_rate == content[0]['settings'][
        'controller.force.damping_rate']
    ages = {path: path.stat().st_mtime_ns for path in tmp_path.glob('cells/*')}
    assert len(ages) == 3
    assert run_study(TuneStudy('dob', ('rigid',)), StudyOptions(tmp_path, jobs=1)) == content
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob('cells/*')} == ages
