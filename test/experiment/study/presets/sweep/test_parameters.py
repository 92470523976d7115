from multicontact_control.errors import ConfigError
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.study.presets.sweep.parameters import (
    overrides_of,
    paths_of,
    unit_of,
    value_of,
)
import pytest


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
