"""Scenarios, presets, and values laid over everything by name."""

from pathlib import Path
import tempfile

from multicontact_control.config import merge, read_parameters, read_yaml, validate
from multicontact_control.control.tasks import ReferenceConfig
from multicontact_control.errors import ConfigError
from multicontact_control.judging.judged_run import simulation_parameters
from multicontact_control.paths import find_config_folder
from multicontact_control.runs.overrides import (
    node_configs,
    resolve_with,
    SET_BY_RUN,
)
from multicontact_control.runs.scenario import preset_values, resolve
import pytest
import yaml

CONFIG = find_config_folder()
SCENARIOS = [path.stem for path in sorted((CONFIG / 'scenarios').glob('*.yaml'))]
PRESETS = [
    path.relative_to(CONFIG / 'presets').with_suffix('').as_posix()
    for path in sorted((CONFIG / 'presets').rglob('*.yaml'))
]


@pytest.mark.parametrize('name', SCENARIOS)
def test_every_scenario_resolves_and_is_named_as_its_file(name):
    assert resolve(name).scenario.name == name


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        (
            {'durration': 3.0},
            'durration: expected a known key .*duration.*, got unknown key',
        ),
        (
            {'reference': {'motion': {'start_time': 1.0, 'amplitud': 0.1}}},
            'reference.motion.amplitud: expected a known key .*amplitude',
        ),
        ({'duration': -1.0}, 'duration: expected greater than or equal to 1, got -1.0'),
        (
            {'reference': {'force_steps': [{'time': 1.0, 'forces': {'wall': 3.0}}]}},
            "reference.force_steps.0.forces: expected contacts among table, board, got 'wall'",
        ),
        (
            {
                'reference': {
                    'motion': {'start_time': 1.0, 'direction_world': [0.0, 0.6, 0.8]}
                }
            },
            'direction_world: expected at most 30 degrees out of the surfaces of table, board',
        ),
        (
            {'controller': {'rate': 250.0}},
            "noise_estimator.rate: expected the controller's 250 Hz",
        ),
        (
            {'noise_estimator': {'contact_names': ['table']}},
            'noise_estimator.contact_names: expected the controller',
        ),
        ({'plant': {'substep': 0.0003}}, 'substep: expected'),
    ],
)
def test_resolve_names_what_is_wrong_in_a_scenario(tmp_path, changes, message):
    path = tmp_path / 'mine.yaml'
    values = read_yaml(CONFIG / 'scenarios/quick.yaml') | changes
    path.write_text(yaml.safe_dump(values), encoding='utf-8')
    with pytest.raises(ConfigError, match=message) as caught:
        setup = resolve(str(path))
        setup.plant.substeps(setup.controller.rate)
    assert '\n' not in str(caught.value)


def test_motion_along_a_normal_is_accepted_once_its_contact_is_let_go():
    steps = [{'time': 2.0, 'forces': {'table': 0.0}}]
    motion = {'start_time': 2.5, 'direction_world': [0.0, 0.0, 1.0]}
    reference = {'force_steps': steps, 'motion': motion}
    setup = resolve('quick', scenario_overrides={'reference': reference})
    assert setup.scenario.reference.motion.direction_world == (0.0, 0.0, 1.0)


def pressed_waypoints(depth):
    """Return a motion through waypoints in the world that leads so far into the table [m]."""
    points = []
    for x in (0.0, 0.1):
        points.append({'position': [x, 0.5, 0.45 - 10.0 * depth * x]})
    return {'kind': 'waypoints', 'start_time': 5.0, 'points': points}


def test_waypoints_through_a_pressed_surface_are_refused_with_the_point():
    values = read_yaml(CONFIG / 'scenarios/circle.yaml')
    values['reference']['motion'] = pressed_waypoints(0.004)
    resolve_values(values)
    values['reference']['motion'] = pressed_waypoints(0.1)
    expected = (
        'reference.motion: point 1: .* of table, got 45 degrees, 100 mm through them'
    )
    with pytest.raises(ConfigError, match=expected):
        resolve_values(values)


def test_circle_out_of_a_pressed_surface_is_refused():
    values = read_yaml(CONFIG / 'scenarios/circle.yaml')
    values['reference']['motion']['centre_direction_world'] = [0.0, 0.0, 1.0]
    with pytest.raises(
        ConfigError, match='at most 30 degrees .* of table, .* 90 degrees'
    ):
        resolve_values(values)


def test_waypoint_force_that_no_contact_holds_is_refused():
    values = read_yaml(CONFIG / 'scenarios/waypoints.yaml')
    points = [{'position': [0.0, 0.0], 'force': 500.0}, {'position': [0.1, 0.0]}]
    values['reference']['motion'] |= {'points': points, 'file': ''}
    with pytest.raises(
        ConfigError, match='motion.points.0.force: expected 0 or .* 500 N'
    ):
        resolve_values(values)


def resolve_values(values):
    """Resolve the values of a scenario as those of a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'mine.yaml'
        path.write_text(yaml.safe_dump(values), encoding='utf-8')
        return resolve(str(path))


def test_the_folder_of_a_run_has_the_waypoints_of_a_file(tmp_path):
    setup = resolve('waypoints')
    setup.write(tmp_path)
    values = read_yaml(tmp_path / 'reference.yaml')
    assert len(values['motion']['points']) == 60
    assert validate(ReferenceConfig, values) == setup.scenario.reference


@pytest.mark.parametrize('name', PRESETS)
def test_preset_says_what_it_sets_and_nothing_else_changes(name):
    plain = resolve('quick')
    setup = resolve('quick', preset=name)
    given = preset_values(name)
    for part in ('controller', 'noise_estimator'):
        values = getattr(plain, part).model_dump()
        changed = getattr(setup, part).model_dump()
        for key in given[part]:
            values[key] = changed[key]
        assert changed == values
    force = setup.controller.model_dump()['force']
    assert merge(force, given['controller']['force']) == force


BOUNDS = {'smallest': 0.2, 'largest': 400.0}


def test_estimator_has_the_bounds_of_the_controllers_variances():
    setup = resolve('quick', controller={'noise_variance': BOUNDS})
    assert setup.noise_estimator.noise_variance == setup.controller.noise_variance
    assert setup.controller.noise_variance.largest == 400.0


def test_other_bounds_of_the_estimator_than_the_controllers_are_refused():
    expected = "the controller's 0.1 to 1000 N.2, got 0.2 to 400 N"
    with pytest.raises(ConfigError, match=f'noise_variance: expected {expected}'):
        resolve('quick', noise_estimator={'noise_variance': BOUNDS})


def test_initial_variance_beyond_its_bounds_is_refused():
    expected = 'initial_noise_variance: expected 0.7 to 1000 N.2'
    with pytest.raises(ConfigError, match=expected):
        resolve('quick', controller={'noise_variance': {'smallest': 0.7}})


def test_preset_paper_is_as_published():
    force = resolve('paper', preset='paper').controller.force
    assert force.allocation == 'paper'
    assert force.projection == 'euclidean'
    assert force.fed_forward == 'estimate'
    assert force.active_state_order == 1
    assert force.process_noise == 1e-3
    assert force.time_constant == 0.02


def test_best_is_the_default():
    best = resolve('quick', preset='best')
    plain = resolve('quick')
    assert best.controller == plain.controller
    assert best.noise_estimator == plain.noise_estimator


def test_options_go_before_a_preset():
    options = {'force': {'damping_rate': 60.0}}
    force = resolve('quick', preset='paper', controller=options).controller.force
    assert force.law == 'aob'
    assert force.damping_rate == 60.0
    assert force.fed_forward == 'estimate'


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('sim_node:\n  ros__parameters: {}\n', 'a section of controller_node'),
        ('controller_node:\n  ros__parameters: {force: {law: pid}}\n', 'force.law'),
    ],
)
def test_preset_that_is_not_acceptable_is_refused(tmp_path, text, message):
    path = tmp_path / 'mine.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        resolve('quick', preset=str(path))


def test_settings_reach_every_part():
    setup = resolve_with(
        resolve,
        {'scenario': 'quick', 'plant': 'rigid'},
        [
            'plant.surfaces.*.stiffness=60000',
            'controller.force.law=dob',
            'controller.force.damping_rate=60',
            'noise_estimator.estimator=fixed',
            'scenario.duration=3',
            'controller.torque_limit=[1, 2, 3, 4, 5, 6]',
        ],
    )
    for surface in setup.plant.surfaces.values():
        assert surface.stiffness == 60_000.0
    assert setup.controller.force.law == 'dob'
    assert setup.controller.force.damping_rate == 60.0
    assert setup.controller.torque_limit == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert setup.noise_estimator.estimator == 'fixed'
    assert setup.scenario.duration == 3.0


@pytest.mark.ros
def test_settings_reach_what_only_a_node_knows():
    setup = resolve_with(
        resolve,
        {'scenario': 'quick'},
        [
            'controller.patience=3',
            'controller.command.force_ceiling=20',
            'plant.payload=0.5',
            'noise_estimator.fifo_priority=7',
            'controller.force.damping_rate=60',
        ],
        nodes=True,
    )
    parameters = simulation_parameters(setup)
    assert parameters['controller_node'] == {'patience': 3, 'command.force_ceiling': 20}
    assert parameters['noise_estimator_node'] == {'fifo_priority': 7}
    assert parameters['sim_node'] == {'payload': 0.5}
    assert setup.controller.force.damping_rate == 60.0


@pytest.mark.ros
def test_setting_of_a_parameter_that_a_run_sets_says_how_it_is_set():
    """With the test before: every parameter of the reference is taken, or what sets it named."""
    for section, config in node_configs().items():
        for name in config.model_fields.keys() & SET_BY_RUN.keys():
            key = f'{section}.{name}'
            with pytest.raises(ConfigError, match=f'--set {key}: .*(give|set|run)'):
                resolve_with(resolve, {'scenario': 'quick'}, [f'{key}=1'], nodes=True)


@pytest.mark.parametrize(
    ('setting', 'message'),
    [
        (
            'controller.patience=0.5',
            r'patience: expected 0, or at least 1 period, got 0.5',
        ),
        ('controller.patients=1', "controller and one of rate, .*'patients'"),
    ],
)
@pytest.mark.ros
def test_bad_setting_of_a_node_is_refused(setting, message):
    with pytest.raises(ConfigError, match=message):
        resolve_with(resolve, {'scenario': 'quick'}, [setting], nodes=True)


@pytest.mark.parametrize(
    ('setting', 'message'),
    [
        ('controller.patience=-1', 'a parameter of a node: only `run` takes it'),
        (
            'controller.command.force_ceiling=20',
            'a parameter of a node: only `run` takes it',
        ),
        ('plant.payload=1', 'a parameter of a node: only `run` takes it'),
        (
            'controller.supervised=false',
            'a parameter of a node, which `run` sets: give --bare',
        ),
        ('plant.speed=2', 'a parameter of a node, which `run` sets: give --speed'),
    ],
)
@pytest.mark.ros
def test_setting_of_a_node_is_named_as_one_where_there_is_no_node(setting, message):
    key = setting.partition('=')[0]
    with pytest.raises(ConfigError, match=f'^--set {key}: {message}'):
        resolve_with(resolve, {'scenario': 'quick'}, [setting])


@pytest.mark.ros
def test_settings_of_nodes_are_in_the_files_of_a_run(tmp_path):
    settings = ['controller.patience=3', 'controller.command.force_ceiling=20']
    setup = resolve_with(resolve, {'scenario': 'quick'}, settings, nodes=True)
    setup.write(tmp_path)
    expected = {'patience': 3, 'command': {'force_ceiling': 20}}
    assert read_parameters(tmp_path / 'nodes.yaml') == expected


@pytest.mark.ros
def test_run_without_settings_of_nodes_has_no_file_of_them(tmp_path):
    setup = resolve_with(resolve, {'scenario': 'quick'}, [], nodes=True)
    setup.write(tmp_path)
    assert not (tmp_path / 'nodes.yaml').exists()


@pytest.mark.parametrize(
    ('setting', 'message'),
    [
        (
            'controller.robot.urdf=nosuch.urdf',
            'controller.robot.urdf: expected a URDF file, got .*nosuch.urdf',
        ),
        ('plant', "--set: expected KEY=VALUE.*'plant'"),
        ('controller.force.damping_rate=[', 'a value as in a YAML file'),
        ('controller.force.wurst=1', "one of law, .*'wurst'"),
        ('scenario.duration=20', '--duration: give either'),
        ('plant.surfaces.*.stiffness=-1', 'stiffness: expected greater than 0'),
    ],
)
def test_bad_setting_is_refused(setting, message):
    options = {'scenario': 'quick', 'plant': 'rigid', 'duration': 4.0}
    with pytest.raises(ConfigError, match=message):
        resolve_with(resolve, options, [setting])
