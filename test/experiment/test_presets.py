"""Presets, and values laid over everything by name."""

from multicontact_control.cli.options import prepare
from multicontact_control.config import ForceConfig, NoiseEstimatorConfig
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.overrides import overridden, read_settings
from multicontact_control.experiment.scenario import (
    law_presets,
    plants_of,
    preset_values,
    PRESETS,
    resolve,
)
from multicontact_control.paths import config_dir
import pytest

NAMES = [path.relative_to(config_dir() / 'presets').with_suffix('').as_posix()
         for path in sorted((config_dir() / 'presets').rglob('*.yaml'))]


def test_every_preset_is_named():
    assert set(PRESETS) < set(law_presets()) == set(NAMES)


@pytest.mark.parametrize('plant', plants_of())
@pytest.mark.parametrize('name', NAMES)
def test_preset_says_what_it_sets_and_nothing_else_changes(name, plant):
    plain, setup = resolve('quick', plant=plant), resolve('quick', plant=plant, preset=name)
    given = preset_values(name)
    for part in ('controller', 'noise_estimator'):
        found, before = (getattr(each, part).model_dump() for each in (setup, plain))
        for key in found:
            if key not in given[part]:
                assert found[key] == before[key]
    for key, value in given['controller']['force'].items():
        found = setup.controller.model_dump()['force'][key]
        assert (found | value if isinstance(value, dict) else value) == found


def test_best_is_what_the_nodes_do():
    best, plain = resolve('quick', preset='best'), resolve('quick')
    assert (best.controller, best.noise_estimator) == (plain.controller, plain.noise_estimator)
    given = preset_values('best')
    assert ForceConfig(**given['controller']['force']) == ForceConfig()
    values = given['noise_estimator']
    assert NoiseEstimatorConfig(contact_names=('a',), **values) == NoiseEstimatorConfig(
        contact_names=('a',))


def test_paper_is_as_published():
    force = resolve('paper', preset='paper').controller.force
    assert (force.law, force.damping_rate, force.fed_forward) == ('aob', 20.0, 'estimate')


def test_scenario_and_options_go_before_a_preset(tmp_path):
    setup = resolve('quick', preset='paper', controller={'force': {'damping_rate': 60.0}})
    assert setup.controller.force.damping_rate == 60.0
    assert setup.controller.force.fed_forward == 'estimate'


def test_preset_may_be_a_file(tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text('/**/controller_node:\n  ros__parameters:\n    force: {law: dob}\n')
    assert resolve('quick', preset=str(path)).controller.force.law == 'dob'


@pytest.mark.parametrize(('text', 'message'), [
    ('sim_node:\n  ros__parameters: {}\n', 'a section of controller_node'),
    ('controller_node:\n  force: {}\n', "holding 'ros__parameters'"),
    ('controller_node:\n  ros__parameters: {force: {law: pid}}\n', 'force.law')])
def test_preset_that_is_not_acceptable_is_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / 'mine.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        resolve('quick', preset=str(path))


def test_unknown_preset_is_named():
    with pytest.raises(ConfigError, match="preset: .*'wurst'"):
        resolve('quick', preset='wurst')


def test_settings_reach_every_part():
    options = {'plant': 'rigid', 'controller': {'force': {'law': 'dob'}}}
    setup = resolve('quick', **overridden(options, [
        'plant.surfaces.*.stiffness=60000', 'controller.force.damping_rate=60',
        'noise_estimator.estimator=fixed', 'scenario.duration=3',
        'controller.torque_limit=[1, 2, 3, 4, 5, 6]'], resolve('quick', plant='rigid')))
    assert {surface.stiffness for surface in setup.plant.surfaces.values()} == {60_000.0}
    assert setup.controller.force.damping_rate == 60.0
    assert setup.controller.force.law == 'dob'
    assert setup.controller.torque_limit == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert setup.noise_estimator.estimator == 'fixed'
    assert setup.scenario.duration == 3.0


@pytest.mark.parametrize(('setting', 'message'), [
    ('plant', "--set: expected KEY=VALUE.*'plant'"), ('=3', '--set: expected KEY=VALUE'),
    ('controller.force.damping_rate=[', 'a value as in a YAML file'),
    ('controller.force.wurst=1', "one of law, .*'wurst'"),
    ('scenario.duration=20', 'duration: expected nothing together with scenario.duration'),
    ('arm.mass=1', 'begins with controller, noise_estimator, plant, scenario'),
    ('plant.surfaces.*.stiffness=-1', 'stiffness: expected greater than 0')])
def test_bad_setting_is_refused_before_anything_starts(tmp_path, setting, message):
    out = tmp_path / 'run'
    with pytest.raises(ConfigError, match=message):
        prepare('quick', 'rigid', 0, 4.0, None, out, False, settings=[setting])
    assert not out.exists()


def test_values_of_settings_are_those_of_yaml():
    assert read_settings(['a.b=1e3', 'c=[x, 2]', 'd=true', 'e=text', 'f=']) == {
        'a.b': '1e3', 'c': ['x', 2], 'd': True, 'e': 'text', 'f': None}
