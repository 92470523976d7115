"""Parameters of a managed node: refused at load, repaired, locked, changed as a whole."""

from __future__ import annotations

from multicontact_control.config import Config, ControllerConfig, parameter, Real, Vector
from multicontact_control.errors import ConfigError
from multicontact_control.nodes.link import GuestNode
from multicontact_control.nodes.parameter_set import ParameterSet
from multicontact_control.paths import config_dir
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter


class Gains(Config):
    stiff: Real = parameter(2.0, 'A gain.', unit='1/s', live=True, ge=0.0, le=10.0)
    soft: Real = parameter(1.0, 'A lower gain.', unit='1/s', live=True)
    order: int = parameter(1, 'An order.', ge=0, le=3)
    weights: Vector = parameter((), 'Weights.', live=True)


class Whole(Config):
    size: Real = parameter(..., 'A size.', unit='m', gt=0.0)
    gains: Gains = Gains()


@pytest.fixture
def make(domain_id, tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'ros'))
    guest = GuestNode('context', domain_id)
    nodes = []

    def make_set(*arguments, model=Whole, file=None):
        files = ['--params-file', str(file)] if file else []
        options = [part for argument in arguments for part in ('-p', argument)]
        nodes.append(Node(
            'parameter_set_test', context=guest.context, use_global_arguments=False,
            start_parameter_services=False, cli_args=['--ros-args', *files, *options]))
        return nodes[-1], ParameterSet(nodes[-1], model)

    yield make_set
    for node in nodes:
        node.destroy_node()
    guest.close()


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
