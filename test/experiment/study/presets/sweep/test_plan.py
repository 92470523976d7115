from multicontact_control.errors import ConfigError
from multicontact_control.experiment.overrides import (
    overrides_of,
    paths_of,
    unit_of,
    value_of,
)
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.study.presets.sweep.config import (
    read_study,
    study_path,
    StudyConfig,
)
from multicontact_control.experiment.study.presets.sweep.plan import plan_sweep
import pytest

STUDY = {'name': 'one', 'scenario': 'step', 'plants': ['rigid'], 'seeds': 2, 'grid': {
    'plant.actuator_delay_ticks': [0, 2], 'noise_estimator.estimator': ['fixed', 'lead_window']}}


def plan_of(**changes):
    return plan_sweep(StudyConfig.model_validate({**STUDY, **changes}), 'study.yaml')


def test_plan_is_every_combination_with_every_seed_on_every_plant_in_order():
    plan = plan_of(plants=['rigid', 'puma'])
    told = [(run.job.plant, *run.values.values(), run.job.seed) for run in plan.runs]
    assert told == [
        (plant, ticks, estimator, seed) for plant in ('rigid', 'puma') for ticks in (0, 2)
        for estimator in ('fixed', 'lead_window') for seed in (0, 1)]
    assert [run.number for run in plan.runs] == list(range(16))
    assert len({run.job.key() for run in plan.runs}) == 16


def test_run_has_the_values_it_was_planned_with():
    run = plan_of().runs[5]
    setup = run.job.setup()
    assert (setup.plant.actuator_delay_ticks, setup.noise_estimator.estimator, setup.seed) == (
        2, 'fixed', 1)
    assert run.values == {
        'plant.actuator_delay_ticks': 2, 'noise_estimator.estimator': 'fixed'}


def test_point_stands_beside_the_grid_with_the_files_values_for_the_rest():
    plan = plan_of(points=[{'controller.force.damping_rate': 30.0}])
    assert len(plan.runs) == 10
    assert plan.runs[-1].values == {
        'plant.actuator_delay_ticks': 1, 'noise_estimator.estimator': 'lead_window',
        'controller.force.damping_rate': 30.0}
    assert plan.runs[0].values['controller.force.damping_rate'] == 100.0
    assert plan.units['controller.force.damping_rate'] == '1/s'


def test_point_that_the_grid_has_is_run_once():
    point = {'plant.actuator_delay_ticks': 0, 'noise_estimator.estimator': 'fixed'}
    assert len(plan_of(points=[point]).runs) == 8


def test_study_without_parameters_is_its_seeds():
    plan = plan_of(grid={}, fixed={'scenario.duration': 2.0})
    assert [(run.job.seed, dict(run.values)) for run in plan.runs] == [(0, {}), (1, {})]
    assert plan.runs[0].job.supervised
    assert not plan_of(supervised=False).runs[0].job.supervised
    assert plan.runs[0].job.setup().scenario.duration == 2.0


@pytest.mark.parametrize(('changes', 'message'), [
    ({'scenario': 'papper'}, 'scenario: expected one of'),
    ({'plants': ['x']}, 'plant: expected one of rigid, puma, or a path'),
    ({'grid': {'controller.farce.x': [1]}}, 'grid.controller.farce.x: expected controller and'),
    ({'points': [{'plant.x': 1}]}, 'points.0.plant.x: expected plant and one of'),
    ({'fixed': {'plant.x': 1}}, 'fixed.plant.x: expected plant and one of'),
    ({'grid': {'controller.force.damping_rate': [20.0, -1.0]}},
     r'grid \(controller.force.damping_rate = -1.0\): force.damping_rate: expected greater than'),
    ({'grid': {'noise_estimator.rate': [250.0]}}, r'grid .*: noise_estimator.rate: expected the'),
    ({'duration': 2.0, 'grid': {'scenario.duration': [2.0, 3.0]}},
     r'grid \(scenario.duration = 2.0\): duration: expected nothing together with '
     'scenario.duration, found 2.0'),
    ({'duration': 4.0, 'grid': {}, 'fixed': {'scenario.duration': 20.0}},
     'duration: expected nothing together with scenario.duration, found 4.0')])
def test_bad_parameter_or_value_is_refused_before_anything_runs(changes, message):
    with pytest.raises(ConfigError, match=f'^study.yaml: {message}') as caught:
        plan_of(**changes)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('name', ['stiffness', 'delay'])
def test_studies_that_come_with_the_package_can_be_planned(name):
    plan = plan_sweep(read_study(study_path(name)))
    assert len(plan.runs) >= 20
    assert all(run.job.key() for run in plan.runs[:3])


@pytest.fixture(scope='module')
def setup():
    return resolve('step', plant='rigid')


@pytest.mark.parametrize(('name', 'value', 'unit'), [
    ('controller.force.input_delay', 0.006, 's'),
    ('noise_estimator.estimator', 'lead_window', ''),
    ('plant.surfaces.board.stiffness', 6000.0, None),
    ('plant.surfaces.*.stiffness', 6000.0, None),
    ('scenario.duration', 4.0, 's'),
    ('scenario.reference.approach.speed', 0.02, 'm/s'),
    ('controller.contacts.*.normal_world', None, None)])
def test_parameter_is_found_by_its_dotted_name(setup, name, value, unit):
    assert value_of(name, setup) == value
    if unit is not None:
        assert unit_of(name, setup) == unit


def test_what_is_no_scalar_is_told_as_json(setup):
    assert value_of('scenario.reference.force_steps', setup) == (
        '[{"time":1.5,"forces":{"table":10.0,"board":10.0}}]')
    assert value_of('controller.contact_names', setup) == '["table","board"]'


@pytest.mark.parametrize(('name', 'message'), [
    ('force.input_delay', 'a dotted name that begins with controller, noise_estimator, plant'),
    ('controller', 'a dotted name that begins with'),
    ('controller.force.inptu_delay', r"controller.force and one of .*input_delay.*'inptu_delay'"),
    ('plant.surfaces.floor.stiffness', "plant.surfaces and one of table, board, found 'floor'"),
    ('controller.rate.x', "controller.rate has no parts here, found 'x'"),
    ('scenario.reference.motion.amplitude', 'scenario.reference.motion has no parts here'),
    ('scenario.plant.drives', "the parameter's own name, plant.drives")])
def test_name_that_leads_nowhere_is_refused(setup, name, message):
    with pytest.raises(ConfigError, match=f'grid.x: expected .*{message}'):
        paths_of(name, setup, 'grid.x')


def test_star_stands_for_every_contact(setup):
    assert overrides_of({
        'plant.surfaces.*.stiffness': 5.0, 'plant.surfaces.board.stiffness': 7.0,
        'controller.force.damping_rate': 30.0}, setup, 'grid') == {
            'plant': {'surfaces': {'table': {'stiffness': 5.0}, 'board': {'stiffness': 7.0}}},
            'controller': {'force': {'damping_rate': 30.0}}}
