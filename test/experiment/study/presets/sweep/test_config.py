"""A study's file: what it may say, and the runs it makes."""

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.overrides import overrides_of, unit_of, value_of
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.study.presets.sweep.config import (
    plan_sweep,
    read_study,
    study_path,
    StudyConfig,
)
from multicontact_control.paths import config_dir
import pytest
import yaml

STUDY = {'name': 'one', 'scenario': 'step', 'plants': ['rigid'], 'seeds': 2, 'grid': {
    'plant.actuator_delay_ticks': [0, 2], 'noise_estimator.estimator': ['fixed', 'lead_window']}}


@pytest.fixture(name='read')
def fixture_read(tmp_path):
    """Return what reads a study with some changes from its file."""
    def read(**changes):
        path = tmp_path / 'study.yaml'
        path.write_text(yaml.safe_dump({**STUDY, 'grid': {}, **changes}))
        return read_study(path, seeds=(5, 6))
    return read


def plan_of(**changes):
    return plan_sweep(StudyConfig.model_validate({**STUDY, **changes}), 'study.yaml')


def test_range_is_spaced_evenly_by_difference_or_by_ratio(read):
    study = read(grid={
        'a.b': {'start': 0.1, 'stop': 0.5, 'count': 5},
        'c.d': {'start': 1.0, 'stop': 1000.0, 'count': 4, 'spacing': 'log'}, 'e.f': [True, 'x']})
    assert study.grid == {'a.b': (0.1, 0.2, 0.3, 0.4, 0.5), 'c.d': (1.0, 10.0, 100.0, 1000.0),
                          'e.f': (True, 'x')}
    assert study.seeds == (5, 6)


@pytest.mark.parametrize(('changes', 'field'), [
    ({'name': 'a/b'}, 'name'), ({'plants': []}, 'plants'), ({'plants': ['x', 'x']}, 'plants'),
    ({'duration': 0.0}, 'duration'), ({'repeats': 3}, 'repeats'),
    ({'grid': 'all'}, 'grid'), ({'grid': {'a.b': 3}}, 'grid.a.b'),
    ({'grid': {'a.b': {'start': 1.0, 'stop': 2.0}}}, 'grid.a.b.count'),
    ({'grid': {'a.b': {'start': 0, 'stop': 2, 'count': 3, 'spacing': 'log'}}}, 'grid.a.b.start'),
    ({'points': [{}]}, 'points.0'), ({'fixed': {'a.b': 1}, 'grid': {'a.b': [2]}}, 'fixed.a.b')])
def test_bad_file_is_refused_by_its_field(read, changes, field):
    with pytest.raises(ConfigError, match=f'study.yaml: {field}: expected .*, found ') as caught:
        read(**changes)
    assert '\n' not in str(caught.value)


def test_studies_that_come_with_the_package_can_be_planned():
    names = sorted(path.stem for path in (config_dir() / 'studies').glob('*.yaml'))
    assert len(names) >= 2
    for name in names:
        plan = plan_sweep(read_study(study_path(name)))
        assert plan.study.name == name and len(plan.runs) >= 20
    with pytest.raises(ConfigError, match=rf"^study: expected one of {', '.join(names)}"):
        study_path('stifness')


def test_plan_is_every_combination_with_every_seed_on_every_plant_in_order():
    plan = plan_of(plants=['rigid', 'puma'])
    assert [(run.job.plant, *run.values.values(), run.job.seed) for run in plan.runs] == [
        (plant, ticks, estimator, seed) for plant in ('rigid', 'puma') for ticks in (0, 2)
        for estimator in ('fixed', 'lead_window') for seed in (0, 1)]
    assert [run.number for run in plan.runs] == list(range(16))
    assert len({run.job.key() for run in plan.runs}) == 16
    setup = plan.runs[5].job.setup()
    assert (setup.plant.actuator_delay_ticks, setup.noise_estimator.estimator, setup.seed) == (
        2, 'fixed', 1)


def test_point_has_the_values_of_the_files_for_the_rest_and_is_run_once():
    known = {'plant.actuator_delay_ticks': 0, 'noise_estimator.estimator': 'fixed'}
    plan = plan_of(points=[known, {'controller.force.damping_rate': 30.0}])
    assert len(plan.runs) == 10
    assert plan.runs[-1].values == {
        'plant.actuator_delay_ticks': 1, 'noise_estimator.estimator': 'lead_window',
        'controller.force.damping_rate': 30.0}
    assert plan.runs[0].values['controller.force.damping_rate'] == 100.0
    assert plan.units['controller.force.damping_rate'] == '1/s'


@pytest.mark.parametrize(('changes', 'field'), [
    ({'scenario': 'papper'}, 'scenario'), ({'plants': ['x']}, 'plant'),
    ({'grid': {'controller.farce.x': [1]}}, 'grid.controller.farce.x'),
    ({'points': [{'plant.x': 1}]}, 'points.0.plant.x'), ({'fixed': {'plant.x': 1}},
                                                         'fixed.plant.x'),
    ({'grid': {'controller.force.damping_rate': [20.0, -1.0]}},
     r'grid \(controller.force.damping_rate = -1.0\): force.damping_rate'),
    ({'grid': {'noise_estimator.rate': [250.0]}}, r'grid .*: noise_estimator.rate'),
    ({'duration': 2.0, 'grid': {'scenario.duration': [2.0, 3.0]}},
     r'grid \(scenario.duration = 2.0\): duration'),
    ({'duration': 4.0, 'grid': {}, 'fixed': {'scenario.duration': 20.0}}, 'duration')])
def test_bad_parameter_or_value_is_refused_before_anything_runs(changes, field):
    with pytest.raises(ConfigError, match=f'^study.yaml: {field}: expected ') as caught:
        plan_of(**changes)
    assert '\n' not in str(caught.value)


@pytest.fixture(name='setup', scope='module')
def fixture_setup():
    return resolve('step', plant='rigid')


@pytest.mark.parametrize(('name', 'value', 'unit'), [
    ('controller.force.input_delay', 0.006, 's'), ('noise_estimator.estimator', 'lead_window', ''),
    ('scenario.reference.approach.speed', 0.02, 'm/s')])
def test_parameter_is_found_by_its_dotted_name(setup, name, value, unit):
    assert (value_of(name, setup), unit_of(name, setup)) == (value, unit)


def test_star_stands_for_every_contact(setup):
    assert overrides_of({
        'plant.surfaces.*.stiffness': 5.0, 'plant.surfaces.board.stiffness': 7.0,
        'controller.force.damping_rate': 30.0}, setup, 'grid') == {
            'plant': {'surfaces': {'table': {'stiffness': 5.0}, 'board': {'stiffness': 7.0}}},
            'controller': {'force': {'damping_rate': 30.0}}}
