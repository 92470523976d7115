"""ROS parameters from configuration models, on real nodes."""

from __future__ import annotations

from multicontact_control.config import (
    Config,
    ControllerConfig,
    NoiseEstimatorConfig,
    parameter,
    read_parameters,
    Real,
    validate,
    Vector,
    write_parameters,
)
from multicontact_control.errors import ConfigError
from multicontact_control.nodes.link import GuestNode
from multicontact_control.nodes.parameters import load_parameters, nested, parameter_specs
from multicontact_control.paths import config_dir
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

CONTROLLER_FILE = config_dir() / 'controller.yaml'


class Inner(Config):
    gain: Real = parameter(2.0, 'A gain.', unit='1/s', live=True, ge=0.0, le=10.0)
    order: int = parameter(1, 'An order.', ge=0, le=3)


class Small(Config):
    size: Real = parameter(..., 'A size.', unit='m', gt=0.0)
    empty: Vector = parameter((), 'Nothing.')
    inner: Inner = Inner()


@pytest.fixture
def make_node(domain_id, tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'ros'))
    guest = GuestNode('context', domain_id)
    nodes = []

    def make(*arguments, text=None, file=None):
        if text is not None:
            file = tmp_path / 'parameters.yaml'
            file.write_text(f'/**:\n  ros__parameters:\n{text}', encoding='utf-8')
        files = ['--params-file', str(file)] if file else []
        options = [part for argument in arguments for part in ('-p', argument)]
        nodes.append(Node(
            'parameter_test', context=guest.context, use_global_arguments=False,
            start_parameter_services=False, cli_args=['--ros-args', *files, *options]))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    guest.close()


def test_load_parameters_reads_what_the_yaml_file_says(make_node):
    node = make_node(file=CONTROLLER_FILE)
    config, = load_parameters(node, ControllerConfig)
    assert config == validate(ControllerConfig, read_parameters(CONTROLLER_FILE))
    name = 'contacts.board.stiffness'
    assert node.get_parameter(name).value == config.contacts['board'].stiffness


def test_load_parameters_reads_back_what_write_parameters_wrote(make_node, tmp_path):
    config = NoiseEstimatorConfig(contact_names=('left', 'right'), window=7, variance_floor=1e-7)
    path = tmp_path / 'written.yaml'
    write_parameters(path, config)
    assert load_parameters(make_node(file=path), NoiseEstimatorConfig) == [config]


def test_load_parameters_takes_a_whole_number_for_a_real_one(make_node):
    config, = load_parameters(make_node(text='    size: 500\n'), Small)
    assert config.size == 500.0
    assert isinstance(config.size, float)


def test_load_parameters_gives_an_empty_list_its_type(make_node):
    node = make_node('size:=1.0', text='    empty: []\n')
    config, = load_parameters(node, Small)
    assert config.empty == ()
    assert node.get_parameter('empty').type_ is Parameter.Type.DOUBLE_ARRAY


def test_load_parameters_declares_description_unit_and_range(make_node):
    node = make_node('size:=1.0')
    load_parameters(node, Small)
    gain = node.describe_parameter('inner.gain')
    assert gain.description == 'A gain. [1/s]'
    assert (gain.floating_point_range[0].from_value, gain.floating_point_range[0].to_value) == (
        0.0, 10.0)
    order = node.describe_parameter('inner.order')
    assert (order.integer_range[0].from_value, order.integer_range[0].to_value) == (0, 3)


def test_load_parameters_makes_all_but_the_live_ones_read_only(make_node):
    node = make_node('size:=1.0')
    load_parameters(node, Small)
    live, fixed = node.set_parameters([
        Parameter('inner.gain', value=3.0), Parameter('size', value=2.0)])
    assert live.successful
    assert not fixed.successful
    assert not node.set_parameters([Parameter('inner.gain', value=11.0)])[0].successful


@pytest.mark.parametrize(('arguments', 'match'), [
    ((), 'size: expected a value, found nothing'),
    (('size:=-1.0',), 'size: expected greater than 0, found -1.0'),
    (('size:=tall',), "size: expected a valid number.*found 'tall'"),
    (('size:=1.0', 'sise:=2.0'), "sise: expected a known parameter .*found unknown 'sise'"),
    (('size:=1.0', 'inner.gian:=2.0'), r'inner.gian: expected a known key \(gain, order\)'),
    (('size:=1.0', 'inner.order:=1.5'), 'inner.order: expected a valid integer'),
    (('size:=1.0', 'inner:=3'), 'inner: expected a mapping, found 3')])
def test_load_parameters_refuses_in_one_line(make_node, arguments, match):
    with pytest.raises(ConfigError, match=match) as caught:
        load_parameters(make_node(*arguments), Small)
    assert '\n' not in str(caught.value)


def test_load_parameters_refuses_a_contact_without_values(make_node):
    node = make_node('contact_names:=["table", "bord"]', file=CONTROLLER_FILE)
    with pytest.raises(ConfigError, match="contact_names: expected names among .*found 'bord'"):
        load_parameters(node, ControllerConfig)


def test_parameter_specs_cover_every_value_of_the_controller():
    overrides = {'contact_names': ['one'], 'contacts.one.stiffness': 1.0}
    names = {spec.name for spec in parameter_specs(ControllerConfig, overrides)}
    assert {'rate', 'force.time_constant', 'contacts.one.normal_world', 'robot.urdf'} <= names
    assert all(spec.descriptor.description for spec in parameter_specs(
        ControllerConfig, overrides))


def test_nested_refuses_a_value_that_is_also_a_section():
    assert nested({'a.b.c': 1, 'a.d': 2}) == {'a': {'b': {'c': 1}, 'd': 2}}
    with pytest.raises(ConfigError, match='a: expected a mapping, found 1'):
        nested({'a': 1, 'a.b': 2})
