"""The configuration: one clear line per bad value, and files that read back."""

from arms import controller_config
from multicontact_control.config import (
    ControllerConfig,
    NoiseEstimatorConfig,
    read_parameters,
    validate,
)
from multicontact_control.errors import ConfigError
from multicontact_control.paths import find_config_folder
from multicontact_control.runs.parameter_file import write_parameters
import pytest

TURNING = {'friction_std': 1.0, 'normal_turn_rate': 1.0, 'tool_turn_limit': 0.2}


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        (
            {'contact_names': ['table', 'wall']},
            r"contact_names: expected distinct names among board, table, got \['table', 'wall'\]",
        ),
        (
            {'contacts': {'table': {'normal_world': [1.0, 0.0, 1.0]}}},
            r'contacts.table.normal_world: expected a vector of unit length .* '
            r'got \[1.0, 0.0, 1.0\]',
        ),
        (
            {'contacts': {'board': {'stiffness': float('nan')}}},
            'contacts.board.stiffness: expected a finite number, got nan',
        ),
        (
            {'force': {'input_delay': 0.021}},
            'force.input_delay: expected at most 0.02 s .* got 0.021 s',
        ),
        (
            {'sensor': {'frozen_ticks': 1}},
            'sensor.frozen_ticks: expected 0, or at least 2, got 1',
        ),
        (
            {'watchdog': {'frozen_joint_ticks': 1}},
            'watchdog.frozen_joint_ticks: expected 0, or at least 2, got 1',
        ),
        (
            {'force': {'stifness': 1.0}},
            "force.stifness: expected a known key .* unknown key 'stifness'",
        ),
        (
            {'force': {'allocation': 'best'}},
            "force.allocation: expected 'decoupled' or 'paper'",
        ),
        (
            {
                'force': {'allocation': 'paper'},
                'contacts': {'table': {'surface_speed_limit': 0.1}},
            },
            'force.allocation: expected decoupled with '
            'contacts.table.surface_speed_limit, got paper',
        ),
        (
            {'torque_limit': [97.6, -186.4, 89.4, 24.2, 20.1, 21.3]},
            'torque_limit.1: expected greater than 0, got -186.4',
        ),
        (
            {'tool': {'bias_sensor': [0.0] * 5}},
            r'tool.bias_sensor: expected at least 6 items, got \[',
        ),
        (
            {'contact_state': {'preload': 80.0}},
            'contact_state.preload: expected below force_ceiling 60 N, got 80 N',
        ),
        (
            {
                'force': {'law': 'lqg'},
                'contacts': {'table': {'surface_speed_limit': 0.05}},
            },
            'contacts.table.surface_speed_limit: expected 0 m/s unless force.law is aob',
        ),
        (
            {'contacts': {'table': {'tool_turn_limit': 0.2}}},
            'contacts.table.normal_turn_rate: expected above 0 rad/s with tool_turn_limit, '
            'got 0',
        ),
        (
            {'contacts': {'table': {**TURNING, 'type': 'edge'}}},
            'contacts.table.tool_turn_limit: expected 0 rad at a contact of type edge, got 0.2',
        ),
        (
            {'contacts': {'table': TURNING, 'board': TURNING}},
            'contacts: expected tool_turn_limit above 0 rad at one contact at most, got '
            'table, board',
        ),
        (
            {'force': {'active_state_order': 0, 'stiffness': 'adaptive'}},
            'force.stiffness',
        ),
        (
            {'force': {'damping_rate': 0.0, 'stiffness': 'adaptive'}},
            'force.damping_rate',
        ),
        ({'rate': 'fast'}, "rate: expected a valid number, got 'fast'"),
        (
            {'sensor': {'filter_order': 1.5}},
            'sensor.filter_order: expected a valid integer, got 1.5',
        ),
        ({'torque_limit': 'x'}, "torque_limit: expected a list of values, got 'x'"),
        (
            {'robot': {'gravity_world': [0.0, 0.0, float('inf')]}},
            'robot.gravity_world.2: expected a finite number',
        ),
    ],
)
def test_validate_names_field_expectation_and_finding(changes, message):
    with pytest.raises(ConfigError, match=f'^controller.yaml: {message}') as caught:
        controller_config(**changes)
    assert '\n' not in str(caught.value)


def test_momentum_observer_is_as_slow_in_the_design_as_it_is():
    """Its bandwidth is bounded by the rate, and so is what the force loops count with."""

    def delay_of(bandwidth):
        return controller_config(
            robot={'sensor_frame': ''},
            wrench_input='momentum',
            collision={'bandwidth': bandwidth},
        ).loop_delay

    fastest = delay_of(200.0)
    assert delay_of(100.0) - fastest == pytest.approx(1 / 100.0 - 1 / 200.0)
    assert delay_of(1000.0) == fastest


def test_noise_estimator_refuses_a_pole_that_its_rate_cannot_have():
    values = {'contact_names': ['a'], 'pole_frequency': 250.0}
    with pytest.raises(ConfigError, match='pole_frequency: expected below 250 Hz'):
        validate(NoiseEstimatorConfig, values)


def test_all_that_is_wrong_is_named_at_once():
    """Keys, types, and what does not fit together, of every section, a line for each."""
    with pytest.raises(ConfigError) as caught:
        controller_config(
            limits={
                'joint_speed': [1.0],
                'workspace_lower': [1.0],
                'workspace_upper': [0.0],
            },
            contact_state={'contact_threshold': 99.0},
            sensor={'full_scale': [-1.0]},
            torque_limit=[1.0],
            contact_names=['table', 'wall'],
            robot={'armature': [1.0]},
        )
    for line in str(caught.value).splitlines():
        assert line.startswith('controller.yaml: ')
    assert {error.field for error in caught.value.errors} == {
        'sensor.full_scale',
        'contact_state.contact_threshold',
        'limits.workspace_lower',
        'limits.joint_speed',
        'robot.armature',
        'torque_limit',
        'contact_names',
    }


def test_normal_of_nearly_unit_length_is_normalised():
    table = {'normal_world': [0.0, 0.0, -1.0009]}
    config = controller_config(contacts={'table': table})
    assert config.contacts['table'].normal_world == (0.0, 0.0, -1.0)


@pytest.mark.parametrize(
    ('name', 'model', 'change'),
    [
        ('controller.yaml', ControllerConfig, {}),
        ('noise_estimator.yaml', NoiseEstimatorConfig, {}),
        (
            'noise_estimator.yaml',
            NoiseEstimatorConfig,
            {'window': 7, 'fixed_variance': 1e-7},
        ),
    ],
)
def test_parameter_files_read_back_as_written(tmp_path, name, model, change):
    config = validate(model, read_parameters(find_config_folder() / name) | change)
    write_parameters(tmp_path / name, {'/**': config.model_dump()})
    assert validate(model, read_parameters(tmp_path / name)) == config


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('a: [1', 'expected valid YAML'),
        ('- 1', 'expected a mapping of keys to values, got list'),
        ('rate: 500.0', "one node key holding 'ros__parameters'"),
        (None, 'No such file'),
    ],
)
def test_file_that_holds_no_parameters_is_named_in_one_line(tmp_path, text, message):
    path = tmp_path / 'bad.yaml'
    if text is not None:
        path.write_text(text, encoding='utf-8')
    with pytest.raises(ConfigError, match=message) as caught:
        read_parameters(path)
    assert str(path) in str(caught.value)
    assert '\n' not in str(caught.value)
