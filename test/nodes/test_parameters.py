"""ROS parameters from configuration models, on real nodes: loaded, refused, locked, changed."""

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
from multicontact_control.nodes.parameters import (
    load_parameters,
    nested,
    parameter_specs,
    ParameterSet,
)
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


class Gains(Config):
    stiff: Real = parameter(2.0, 'A gain.', unit='1/s', live=True, ge=0.0, le=10.0)
    soft: Real = parameter(1.0, 'A lower gain.', unit='1/s', live=True)
    order: int = parameter(1, 'An order.', ge=0, le=3)
    weights: Vector = parameter((), 'Weights.', live=True)


class Whole(Config):
    size: Real = parameter(..., 'A size.', unit='m', gt=0.0)
    gains: Gains = Gains()


@pytest.fixture
def make(make_node):
    def make_set(*arguments, model=Whole, file=None):
        node = make_node(*arguments, file=file)
        return node, ParameterSet(node, model)
    return make_set


def change(node, name, value):
    return node.set_parameters([Parameter(name, value=value)])[0]


def test_configurations_are_those_of_the_file(make):
    _, parameters = make(model=ControllerConfig, file=config_dir() / 'controller.yaml')
    config, = parameters.configurations()
    assert config.contacts['board'].normal_world == (0.0, 1.0, 0.0)


@pytest.mark.parametrize(('argument', 'match', 'repair'), [
    (None, 'size: expected a value, found nothing', ('size', 1.0)),
    ('size:=-1.0', 'size: expected greater than 0, found -1.0', ('size', 1.0)),
    ('size:=tall', "size: expected a valid number.*found 'tall'", ('size', 1.0)),
    ('gains.order:=7', 'gains.order: expected less than or equal to 3', ('gains.order', 2))])
def test_what_is_wrong_is_refused_by_name_until_it_is_repaired(make, argument, match, repair):
    given = [] if argument is None else [argument]
    if repair[0] != 'size':
        given.append('size:=1.0')
    node, parameters = make(*given)
    with pytest.raises(ConfigError, match=match):
        parameters.configurations()
    assert change(node, *repair).successful
    parameters.configurations()


@pytest.mark.parametrize(('argument', 'match'), [
    ('sise:=1.0', "sise: expected a known parameter .*found unknown 'sise'"),
    ('gains.stif:=1.0', 'gains.stif: expected a known key')])
def test_unknown_names_are_refused(make, argument, match):
    _, parameters = make('size:=1.0', argument)
    with pytest.raises(ConfigError, match=match):
        parameters.configurations()


def test_only_live_parameters_change_once_locked(make):
    node, parameters = make('size:=1.0')
    applied = []
    parameters.lock(lambda configs: None, applied.extend)
    result = change(node, 'size', 2.0)
    assert not result.successful
    assert 'size: expected 1.0: it can be changed only while the node is unconf' in result.reason
    assert change(node, 'size', 1.0).successful  # no change
    assert change(node, 'gains.stiff', 3.0).successful
    assert applied[-1] == Whole(size=1.0, gains=Gains(stiff=3.0))
    parameters.unlock()
    assert change(node, 'size', 2.0).successful
    assert parameters.configurations()[0].size == 2.0


def test_a_refused_change_changes_nothing_and_is_told(make):
    node, parameters = make('size:=1.0')
    applied, told = [], []

    def check(configs):
        if configs[0].gains.soft > configs[0].gains.stiff:
            raise ConfigError('gains.soft', 'less than stiff', configs[0].gains.soft)

    parameters.lock(check, applied.extend)
    parameters.refused = lambda name, error: told.append((name, str(error)))
    result = change(node, 'gains.soft', 5.0)
    assert (result.successful, result.reason) == (
        False, 'gains.soft: expected less than stiff, found 5.0')
    assert node.get_parameter('gains.soft').value == 1.0
    assert not applied
    assert told == [('gains.soft', result.reason)]
    both = node.set_parameters_atomically([
        Parameter('gains.soft', value=5.0), Parameter('gains.stiff', value=6.0)])
    assert both.successful
    assert len(applied) == 1
    assert (applied[0].gains.soft, applied[0].gains.stiff) == (5.0, 6.0)


def test_a_check_that_breaks_refuses_the_change(make):
    node, parameters = make('size:=1.0')
    applied, told = [], []

    def check(configs):
        raise ValueError if configs[0].gains.soft else ArithmeticError('no solution')

    parameters.lock(check, applied.extend)
    parameters.refused = lambda name, error: told.append((name, type(error)))
    results = [change(node, 'gains.soft', value) for value in (5.0, 0.0)]
    assert [(x.successful, x.reason) for x in results] == [
        (False, 'ValueError()'), (False, 'no solution')]
    assert told == [('gains.soft', ValueError), ('gains.soft', ArithmeticError)]
    assert not applied


def test_a_list_can_be_empty_and_filled(make):
    node, parameters = make('size:=1.0')
    assert parameters.configurations()[0].gains.weights == ()
    parameters.lock(lambda configs: None, lambda configs: None)
    assert change(node, 'gains.weights', [1.0, 2.0]).successful
    assert parameters.configurations()[0].gains.weights == (1.0, 2.0)


def test_assign_says_what_is_wrong(make):
    _, parameters = make('size:=1.0')
    parameters.lock(lambda configs: None, lambda configs: None)
    parameters.assign('gains.stiff', 4.0)
    assert parameters.value('gains.stiff') == 4.0
    with pytest.raises(ConfigError, match='gains.stiff: expected an acceptable value'):
        parameters.assign('gains.stiff', 40.0)


def test_descriptors_say_what_can_be_changed_when(make):
    node, _ = make('size:=1.0')
    assert node.describe_parameter('gains.stiff').description == 'A gain. [1/s]'
    assert 'only while' not in node.describe_parameter('gains.stiff').additional_constraints
    assert 'only while' in node.describe_parameter('size').additional_constraints
