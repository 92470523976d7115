"""ROS parameters from configuration models, on real nodes: loaded, refused, locked, changed."""

from __future__ import annotations

import contextlib
from pathlib import Path

from arms import controller_config, seven_joint_urdf
from multicontact_control.config import Config, ControllerConfig, parameter, Vector
from multicontact_control.errors import ConfigError
from multicontact_control.nodes.link import ServiceClientNode
from multicontact_control.nodes.parameters import (
    find_parameter_folder,
    load_parameters,
    ParameterSet,
)
from multicontact_control.nodes.private import parameter_overrides
from multicontact_control.paths import find_config_folder
from multicontact_control.runs.parameter_file import write_parameters
from multicontact_control.runs.scenario import (
    flatten_parameters,
    read_controller_files,
    resolve,
)
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from sim_bridge.new_robot import new_robot

CONTROLLER_FILE = find_config_folder() / 'controller.yaml'


class Gains(Config):
    stiff: float = parameter(2.0, 'A gain.', unit='1/s', live=True, ge=0.0, le=10.0)
    soft: float = parameter(1.0, 'A lower gain.', unit='1/s', live=True)
    order: int = parameter(1, 'An order.', ge=0, le=3)
    weights: Vector = parameter((), 'Weights.', live=True)


class Whole(Config):
    size: float = parameter(..., 'A size.', unit='m', gt=0.0)
    gains: Gains = Gains()


@pytest.fixture
def make_node(domain_id, tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'ros'))
    with (
        ServiceClientNode('context', domain_id) as guest,
        contextlib.ExitStack() as nodes,
    ):

        def make(*arguments, file=None):
            options = ['--ros-args']
            if file:
                options += ['--params-file', str(file)]
            for argument in arguments:
                options += ['-p', argument]
            node = Node(
                'controller_node',
                context=guest.context,
                use_global_arguments=False,
                start_parameter_services=False,
                cli_args=options,
            )
            nodes.callback(node.destroy_node)
            return node

        yield make


def test_load_parameters_reads_what_a_file_says(make_node, tmp_path):
    node = make_node(file=CONTROLLER_FILE)
    (config,) = load_parameters(node, ControllerConfig)
    assert config == controller_config()
    name = 'contacts.board.stiffness'
    assert node.get_parameter(name).value == config.contacts['board'].stiffness
    file = tmp_path / 'parameters.yaml'
    # YAML has no type for whole numbers and empty lists.
    file.write_text('/**: {ros__parameters: {size: 500, gains: {weights: []}}}')
    (config,) = load_parameters(make_node(file=file), Whole)
    assert isinstance(config.size, float)
    assert config.gains.weights == ()


def new_robot_file(folder):
    urdf = seven_joint_urdf(folder)
    file = folder / 'controller.yaml'
    new_robot(urdf, 'wrist', 'wrist', folder / 'mine.yaml', file)
    return file


def quick_file(folder):
    return resolve('quick').write(folder)['controller_node']


def gantry_file(folder):
    """Names and numbers that rcl takes for something else, or not at all."""
    values = {
        'watchdog': {},
        'robot': {'joint_names': ['x', 'y', '1e5', 'n']},
        'tool': {'mass': 1, 'com_sensor': [0, 0.05, 0]},
        'contact_names': [],
    }
    file = folder / 'gantry.yaml'
    write_parameters(file, {'controller_node': values})
    return file


@pytest.mark.parametrize('write', [new_robot_file, gantry_file, quick_file])
def test_file_that_a_command_writes_is_read_by_nodes_and_commands_alike(
    make_node, tmp_path, write
):
    file = write(tmp_path)
    overrides = parameter_overrides(make_node(file=file))
    read = read_controller_files([file])
    expected = flatten_parameters(read.controller | read.node)
    values = {}
    for name, override in overrides.items():
        values[name] = override.value
        if isinstance(expected.get(name), list):
            values[name] = list(override.value or ())
    assert expected
    assert values == expected


@pytest.mark.parametrize(
    ('arguments', 'match'),
    [
        ((), 'size: expected a value, got nothing'),
        (('size:=-1.0',), 'size: expected greater than 0, got -1.0'),
        (('size:=tall',), "size: expected a valid number, got 'tall'"),
        (
            ('size:=1.0', 'sise:=2.0'),
            "sise: expected a known parameter .*got unknown 'sise'",
        ),
        (('size:=1.0', 'gains.order:=1.5'), 'gains.order: expected a valid integer'),
        (
            ('size:=1.0', 'gains:=3'),
            'gains: expected a mapping of keys to values, got 3',
        ),
    ],
)
def test_load_parameters_refuses_in_one_line(make_node, arguments, match):
    with pytest.raises(ConfigError, match=match) as caught:
        load_parameters(make_node(*arguments), Whole)
    assert '\n' not in str(caught.value)


def test_parameter_set_applies_changes_that_pass_the_check_as_a_whole(make_node):
    node = make_node('size:=1.0')
    applied = []
    refused = []
    parameters = ParameterSet(node, Whole)

    def use(configs):
        (config,) = configs
        gains = config.gains
        if gains.soft > gains.stiff:
            raise ConfigError('gains.soft', 'less than stiff', gains.soft)
        if gains.soft == 0.0:
            raise ArithmeticError('no solution')
        applied.append((gains.soft, gains.stiff))

    def note_refusal(name, error):
        refused.append((name, str(error)))

    parameters.apply_design = use
    parameters.report_refusal = note_refusal
    for value, reason in (
        (5.0, 'gains.soft: expected less than stiff, got 5.0'),
        (0.0, 'no solution'),
    ):
        (result,) = node.set_parameters([Parameter('gains.soft', value=value)])
        assert not result.successful
        assert result.reason == reason
        assert refused[-1] == ('gains.soft', reason)
    assert node.get_parameter('gains.soft').value == 1.0
    assert not applied
    both = [Parameter('gains.soft', value=5.0), Parameter('gains.stiff', value=6.0)]
    assert node.set_parameters_atomically(both).successful
    assert applied == [(5.0, 6.0)]


@pytest.mark.parametrize(
    ('given', 'folder'),
    [
        (('mine', 'launch'), 'mine'),
        (('launch', 'mine'), 'mine'),
        (('mine', 'other'), 'other'),
        (('mine', 'dotted'), 'dotted'),
        (('launch', 'stranger'), ''),
        ((), ''),
    ],
)
def test_path_is_relative_to_the_last_file_that_sets_it(tmp_path, given, folder):
    """A launch file's own, which is temporary, often comes last."""
    arguments = ['--ros-args', '-p', 'rate:=500.0']
    for name in given:
        (tmp_path / name).mkdir()
        file = tmp_path / name / 'parameters.yaml'
        file.write_text(PARAMETER_FILES[name])
        arguments += ['--params-file', str(file)]
    expected = Path()
    if folder:
        expected = tmp_path / folder
    assert folder_of_urdf(arguments) == expected
    for text in ('robot.urdf:=here.urdf', 'controller_node:robot.urdf:=here.urdf'):
        assert folder_of_urdf([*arguments, '-p', text]) == Path()


PARAMETER_FILES = {
    'mine': '/**: {ros__parameters: {robot: {urdf: a.urdf, joint_names: []}}}',
    'other': 'left: {controller_node: {ros__parameters: {robot: {urdf: b}}}}',
    'dotted': '/left/controller_node: {ros__parameters: {robot.urdf: c.urdf}}',
    'stranger': 'sim_node: {ros__parameters: {robot: {urdf: d.urdf}}}',
    'launch': '/**: {ros__parameters: {robot: {armature: [0.1]}}}',
}


def folder_of_urdf(arguments):
    return find_parameter_folder('robot.urdf', 'controller_node', arguments)
