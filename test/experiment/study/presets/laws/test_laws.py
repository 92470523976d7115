"""The race of force laws: its runs, what is measured, and what is said of them."""

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.study.presets.laws import jobs
from multicontact_control.experiment.study.presets.laws.jobs import (
    DELAY,
    FRICTION,
    LawJob,
    run_law_job,
    STIFFNESS,
    TASK,
    VANISHING,
)
from multicontact_control.experiment.study.presets.laws.results import (
    law_findings,
    law_listing,
    law_rows,
)
from multicontact_control.experiment.study.presets.laws.study import LawStudy
import pytest


def test_grid_has_every_law_in_every_situation():
    jobs = LawStudy().jobs()
    assert len(jobs) == len(set(jobs)) == 9 * 3 * (2 * (2 + 8 + 3) + 3)
    assert {job.seed for job in jobs} == {1, 2, 3}  # tuned on 0
    assert not any(job.situation == FRICTION and job.plant == 'rigid' for job in jobs)


def test_situations_change_the_plant_and_nothing_else():
    plain = LawJob('best', 'puma', 1, STIFFNESS).setup()
    assert {s.stiffness for s in plain.plant.surfaces.values()} == {6000.0}
    stiff = LawJob('best', 'puma', 1, STIFFNESS, 5.0).setup()
    assert {s.stiffness for s in stiff.plant.surfaces.values()} == {30_000.0}
    assert stiff.controller == plain.controller
    assert LawJob('best', 'puma', 1, DELAY, 3.0).setup().plant.actuator_delay_ticks == 3
    rough = LawJob('best', 'puma', 1, FRICTION, 4.0).setup()
    assert rough.plant.joint_friction_scale == pytest.approx(
        4.0 * plain.plant.joint_friction_scale)
    assert rough.controller == plain.controller


def test_settings_are_laid_over_the_preset():
    job = LawJob('laws/dob', 'puma', 0, TASK, settings=(
        ('controller.force.dob.bandwidth', 33.0), ('noise_estimator.slew_time', 0.02)))
    setup = job.setup()
    assert setup.controller.force.law == 'dob'
    assert setup.controller.force.dob.bandwidth == 33.0
    assert setup.noise_estimator.slew_time == 0.02
    assert job.key() != LawJob('laws/dob', 'puma', 0, TASK).key()


@pytest.mark.slow
def test_run_measures_task_and_vanishing_surface():
    task = run_law_job(LawJob('best', 'rigid', 1, TASK)).metrics
    assert task['stable']
    assert task['neighbour_n'] is None
    for contact in task['contacts'].values():
        assert 0.0 < contact['rest_rms_n'] < 0.1
        assert all(0.01 < step['rise_s'] < 0.1 for step in contact['steps'])
        assert contact['push_off_s'] is not None
    gone = run_law_job(LawJob('best', 'rigid', 1, VANISHING)).metrics
    assert 0.1 < gone['neighbour_n'] < 5.0


def test_run_that_ends_before_its_surface_vanishes_is_measured(monkeypatch):
    """Its neighbour was never alone, which is no reason to end the race."""
    monkeypatch.setitem(jobs.DURATIONS, VANISHING, 0.2)
    assert run_law_job(LawJob('best', 'rigid', 1, VANISHING)).metrics['neighbour_n'] is None


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


def test_push_that_is_never_controlled_out_has_no_time():
    row, = rows_of({('best', 1, TASK, 1.0): metrics(push_off_s=None)})
    assert row['push_off_s'] is None


def test_table_tells_stable_from_calm():
    lost = metrics() | {'stable': False}
    wild = lost | {'oscillates': True}
    rows = rows_of({
        ('best', 1, TASK, 1.0): metrics(), ('best', 1, STIFFNESS, 2.0): metrics(),
        ('best', 1, STIFFNESS, 5.0): lost, ('best', 1, STIFFNESS, 20.0): wild})
    assert law_listing(rows, 'puma').lines[0].cells[10] == '2 (5)'


def test_findings_name_what_a_law_is_good_for_and_what_not():
    rough = metrics() | {'activity_nm': 5.0}
    unstable = metrics() | {'stable': False}
    quiet, loud, failed = law_findings(rows_of({
        ('best', 1, TASK, 1.0): metrics(), ('laws/pi', 1, TASK, 1.0): rough,
        ('laws/lqg', 1, TASK, 1.0): unstable}))
    assert 'smooth torque' in quiet.split('not at')[0]
    assert 'not at smooth torque (5.00 N m)' in loud
    assert failed == 'puma, laws/lqg: not stable in 1 of 1 runs of the task.'


@pytest.mark.parametrize('options', [
    {'presets': ('wurst',)}, {'plants': ('wurst',)}, {'seeds': 0}])
def test_study_refuses_what_it_does_not_know(options):
    with pytest.raises(ConfigError):
        LawStudy(**options).check()
