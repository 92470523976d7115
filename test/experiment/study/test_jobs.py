import pickle

from multicontact_control.experiment.study import jobs
from multicontact_control.experiment.study.jobs import job_of


def test_job_key_does_not_depend_on_the_order_of_overrides():
    first = job_of('quick', 'rigid', 0, controller={'force': {
        'damping_rate': 30.0, 'input_delay': 0.002}})
    second = job_of('quick', 'rigid', 0, controller={'force': {
        'input_delay': 0.002, 'damping_rate': 30.0}})
    assert first == second and hash(first) == hash(second)
    assert first.key() == second.key() == pickle.loads(pickle.dumps(first)).key()


def test_job_key_changes_with_all_that_changes_the_outcome():
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


def test_job_key_is_that_of_the_values_not_of_how_they_were_given():
    given = job_of('quick', 'rigid', 0, controller={'force': {'damping_rate': 100.0}})
    assert given.key() == job_of('quick', 'rigid', 0).key()
    assert given.key() == job_of('quick', 'rigid', 0, preset='best').key()
    assert given.key() != job_of('quick', 'rigid', 0, preset='paper').key()


def test_job_key_changes_with_the_code(monkeypatch):
    """Nobody shall get yesterday's results from today's controller."""
    before = job_of('quick', 'rigid', 0).key()
    monkeypatch.setattr(jobs, 'code_stamp', lambda: 'other code')
    assert job_of('quick', 'rigid', 0).key() != before
