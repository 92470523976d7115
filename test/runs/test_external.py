"""What a user's files say of a robot that is not this package's."""

from dataclasses import replace

import click
from foreign_bag import controller_file, JOINTS
from multicontact_control.cli.options import RunOptions
from multicontact_control.errors import ConfigError
from multicontact_control.files import replace_json_file
from multicontact_control.judging.results import infer_contact_types, load_setup
from multicontact_control.runs.parameter_file import write_parameters
from multicontact_control.runs.scenario import (
    resolve,
    resolve_external,
)
import pytest
import typer
import yaml

SCENARIO = {
    'name': 'mine',
    'duration': 5.0,
    'reference': {'force_steps': [{'time': 2.0, 'forces': {'wall': 10.0}}]},
}


@pytest.fixture(name='file')
def fixture_file(tmp_path):
    return controller_file(tmp_path)


def context_with(*options):
    """Return the context of a command that some options were given to."""
    context = typer.Context(click.Command('run'))
    for name in options:
        context.set_parameter_source(name, click.core.ParameterSource.COMMANDLINE)
    return context


def test_controller_file_is_all_that_is_needed(file):
    setup = resolve_external([file])
    assert setup.controller.robot.joint_names == JOINTS
    assert setup.noise_estimator.contact_names == ('wall',)
    assert setup.noise_estimator.rate == setup.controller.rate
    assert (setup.simulated, setup.commanded_by_topic, setup.nodes, setup.endless) == (
        False,
        True,
        {},
        True,
    )
    assert setup.urdf_dir == file.parent


def test_later_files_preset_scenario_law_and_settings_are_laid_over(file, tmp_path):
    tool = tmp_path / 'tool.yaml'
    scenario = tmp_path / 'mine.yaml'
    write_parameters(
        tool,
        {
            '/**': {
                'tool': {'mass': 0.8},
                'patience': 9.0,
                'timing_file': 'x',
                'command': {'force_ceiling': 25.0},
            }
        },
    )
    scenario.write_text(yaml.safe_dump(SCENARIO))
    options = RunOptions(
        scenario=str(scenario),
        noise_estimator='fixed',
        preset='adaptive',
        settings=[
            'controller.force.damping_rate=33',
            'scenario.duration=6',
            'controller.pair_tolerance=0.2',
        ],
    )
    setup = options.external([file, tool], context_with('scenario', 'preset'))
    assert setup.controller.tool.mass == 0.8
    assert setup.controller.force.stiffness == 'adaptive'
    assert setup.controller.force.damping_rate == 33.0
    assert setup.noise_estimator.estimator == 'fixed'
    assert (setup.scenario.duration, setup.commanded_by_topic) == (6.0, False)
    assert setup.node_parameters('controller') == {
        'patience': 9.0,
        'command.force_ceiling': 25.0,
        'pair_tolerance': 0.2,
    }


def test_what_a_file_says_for_every_node_lies_below_the_sections_of_both(file):
    content = yaml.safe_load(file.read_text())
    content['/**'] = {
        'ros__parameters': {
            'rate': 250.0,
            'tool': {'mass': 0.8},
            'window': 30,
            'variance_scale': 2.0,
        }
    }
    content['controller_node']['ros__parameters'].pop('rate')
    content['/left/noise_estimator_node'] = {'ros__parameters': {'window': 20}}
    file.write_text(yaml.safe_dump(content))
    setup = resolve_external([file])
    assert (setup.controller.rate, setup.controller.tool.mass) == (250.0, 0.8)
    assert setup.nodes == {}
    estimator = setup.noise_estimator
    assert (estimator.rate, estimator.window, estimator.variance_scale) == (
        250.0,
        20,
        2.0,
    )


def test_parameter_file_may_name_nodes_in_a_namespace(file):
    wanted = resolve_external([file])
    content = yaml.safe_load(file.read_text())
    file.write_text(yaml.safe_dump({'/left': {'/**': content['controller_node']}}))
    assert resolve_external([file]) == wanted


@pytest.mark.parametrize(
    ('key', 'message'),
    [
        (
            'controler_node',
            r'controler_node: expected a section of \*\*, controller_node, ',
        ),
        (
            '/left/controller_node',
            "expected a section of .* got 'controller_node' again",
        ),
        ('rate', 'rate: expected a section of .* got '),
    ],
)
def test_section_that_would_be_lost_is_refused(file, key, message):
    content = yaml.safe_load(file.read_text())
    file.write_text(
        yaml.safe_dump(
            {
                **content,
                key: 250.0 if key == 'rate' else {'ros__parameters': {'rate': 250.0}},
            }
        )
    )
    with pytest.raises(ConfigError, match=message):
        resolve_external([file])


@pytest.mark.parametrize('simulated', [False, True])
def test_setup_that_was_written_is_read_back(file, tmp_path, simulated):
    setup = (
        resolve('edge', plant='puma', seed=3)
        if simulated
        else resolve_external([file], duration=3.0)
    )
    files = setup.write(tmp_path / 'run/config')
    assert ('sim_node' in files) == simulated
    replace_json_file(
        tmp_path / 'run/summary.json',
        {
            'schema': 1,
            'plant': setup.plant_name,
            'seed': setup.seed,
            'commanded_by_topic': setup.commanded_by_topic,
        },
    )
    again = load_setup(tmp_path / 'run')
    assert again == replace(setup, urdf_dir=tmp_path / 'run/config')
    assert (again.urdf_dir / setup.controller.robot.urdf).is_file()


@pytest.mark.parametrize(
    ('changes', 'options', 'message'),
    [
        (
            {'contact_names': ['floor']},
            {},
            'contact_names: expected distinct names among wall',
        ),
        (
            {
                'robot': {
                    'urdf': 'none.urdf',
                    'joint_names': ['a'],
                    'operational_frame': 'x',
                    'sensor_frame': 'x',
                },
                'torque_limit': [],
            },
            {},
            'robot.urdf: expected a readable',
        ),
        ({}, {'scenario': 'paper'}, 'expected contacts among wall, got'),
        (
            {'reference_file': 'x.yaml'},
            {},
            'reference_file: got x.yaml; give --scenario',
        ),
        ({}, {'preset': 'x'}, 'preset: expected one of'),
    ],
)
def test_bad_input_is_refused_in_a_line(tmp_path, changes, options, message):
    file = controller_file(tmp_path, **changes)
    with pytest.raises(ConfigError, match=message) as caught:
        resolve_external([file], **options)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    ('setting', 'message'),
    [
        ('scenario.duration=20', 'scenario.duration: name the --scenario'),
        ('plant.surfaces.*.stiffness=1', 'plant has no parts'),
    ],
)
def test_setting_without_what_it_is_laid_over_is_refused(file, setting, message):
    with pytest.raises(ConfigError, match=message):
        RunOptions(settings=[setting]).external([file], context_with())


def test_contact_types_follow_from_names():
    names = ('a', 'b', 'b/along', 'c', 'c/along', 'c/across')
    assert infer_contact_types(names) == {'a': 'point', 'b': 'edge', 'c': 'plane'}
