"""Scenarios: the files that are there, and one line for what is wrong with others."""

from multicontact_control.config import ControllerConfig, read_parameters, read_yaml, validate
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.scenario import resolve, scenario_path
from multicontact_control.paths import config_dir
import numpy as np
import pytest
import yaml


@pytest.mark.parametrize('path', sorted((config_dir() / 'scenarios').glob('*.yaml')),
                         ids=lambda path: path.stem)
def test_every_scenario_resolves_and_is_named_as_its_file(path):
    """Whatever lies in config/scenarios can be run."""
    assert resolve(path.stem).scenario.name == path.stem


def test_commanded_forces_are_those_of_the_file():
    """Preload, a step on both contacts, one on the table alone; each from its sample on."""
    setup = resolve('disturbance')
    commanded = setup.commanded(np.array([0.0, 1.998, 2.0, 3.499, 3.5, 16.0]))
    np.testing.assert_array_equal(commanded, [
        [2.0, 2.0], [2.0, 2.0], [10.0, 10.0], [10.0, 10.0], [15.0, 10.0], [15.0, 10.0]])


def _scenario(tmp_path, **changes):
    values = {**read_yaml(config_dir() / 'scenarios' / 'quick.yaml'), **changes}
    path = tmp_path / 'mine.yaml'
    path.write_text(yaml.safe_dump(values), encoding='utf-8')
    return str(path)


@pytest.mark.parametrize(('changes', 'message'), [
    ({'durration': 3.0}, 'durration: expected a known key .*duration.*, found unknown key'),
    ({'reference': {'motion': {'start_time': 1.0, 'amplitud': 0.1}}},
     'reference.motion.amplitud: expected a known key .*amplitude'),
    ({'duration': -1.0}, 'duration: expected greater than 0, found -1.0'),
    ({'reference': {'force_steps': [{'time': 1.0, 'forces': {'wall': 3.0}}]}},
     "reference.force_steps.0.forces: expected contacts among table, board, found 'wall'"),
    ({'controller': {'force': {'input_delay': 1.0}}}, 'force.input_delay: expected at most 10'),
    ({'controller': {'rate': 250.0}}, "noise_estimator.rate: expected the controller's 250 Hz"),
    ({'noise_estimator': {'contact_names': ['table']}},
     'noise_estimator.contact_names: expected the controller'),
    ({'plant': {'substep': 0.0003}}, 'substep: expected'),
])
def test_resolve_names_what_is_wrong_in_a_scenario(tmp_path, changes, message):
    """Field, expectation and finding, on one line."""
    with pytest.raises(ConfigError, match=message) as caught:
        setup = resolve(_scenario(tmp_path, **changes))
        setup.plant.substeps(setup.controller.rate)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('arguments', 'message'), [
    ({'scenario': 'papper'}, "scenario: expected one of .*paper, .*quick, .*found 'papper'"),
    ({'scenario': 'quick', 'plant': 'stiff'}, "plant: expected one of rigid, puma, .*'stiff'"),
    ({'scenario': 'quick', 'seed': -1}, 'seed: expected a whole number >= 0, found -1'),
    ({'scenario': 'quick', 'duration': 0.0}, 'duration: expected greater than 0')])
def test_resolve_refuses_unknown_names_and_numbers_out_of_range(arguments, message):
    """The known names are listed."""
    with pytest.raises(ConfigError, match=message):
        resolve(**arguments)


def test_overrides_are_laid_over_files_in_order(tmp_path):
    """File, then scenario, then argument."""
    path = _scenario(tmp_path, controller={'force': {'damping_rate': 30.0}})
    setup = resolve(path, controller={'motion': {'natural_frequency': 20.0}}, duration=2.0)
    assert setup.controller.force.damping_rate == 30.0
    assert setup.controller.motion.natural_frequency == 20.0
    assert setup.ticks == 1000


def test_written_configuration_is_what_the_nodes_read(tmp_path):
    """The folder of a run can be run again, with its own URDF beside it."""
    setup = resolve('quick')
    setup.write(tmp_path / 'config')
    again = validate(ControllerConfig, read_parameters(tmp_path / 'config' / 'controller.yaml'))
    assert again == setup.controller
    assert (tmp_path / 'config' / 'puma560.urdf').is_file()
    assert resolve(str(tmp_path / 'config' / 'scenario.yaml')).scenario == setup.scenario


def test_scenario_path_takes_a_path(tmp_path):
    """A file of one's own."""
    assert str(scenario_path(_scenario(tmp_path))) == str(tmp_path / 'mine.yaml')
