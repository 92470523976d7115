from arms import plant_config
from multicontact_control.errors import ConfigError
import pytest


def changed(change, preset='puma'):
    return plant_config(preset, **change)


@pytest.mark.parametrize('name', ['puma', 'rigid'])
def test_presets_load_and_divide_the_control_period(name):
    assert plant_config(name).substeps(500.0) >= 1


def test_presets_are_what_they_are_called():
    rigid, puma = plant_config('rigid'), plant_config('puma')
    assert (rigid.drives, rigid.joint_friction_scale) == ('rigid', 0.0)
    assert (puma.drives, puma.joint_friction_scale, puma.joint_sensing) == (
        'flexible', 0.25, 'motor')
    assert rigid.actuator_delay_ticks == puma.actuator_delay_ticks == 1
    assert rigid.surfaces == puma.surfaces
    assert rigid.sensor == puma.sensor


@pytest.mark.parametrize(('change', 'message'), [
    ({'contact_names': ['table', 'wall']},
     "contact_names: expected names among board, table, found 'wall'"),
    ({'contact_names': ['table', 'table']}, 'contact_names: expected distinct names'),
    ({'drive_stiffness': [1.0, 2.0]}, 'drive_stiffness: expected 6 values, found 2'),
    ({'drive_stiffness': [0.0] * 6}, 'drive_stiffness: expected values above 0'),
    ({'drive_damping': [-1.0] * 6}, 'drive_damping: expected no negative value'),
    ({'torque_limit': [1.0] * 5}, 'torque_limit: expected 6 values, found 5'),
    ({'push_start': [1.0]}, 'push_duration: expected 1 value, found 0'),
    ({'push_start': [1.0], 'push_duration': [0.1], 'push_force_world': [1.0, 2.0]},
     'push_force_world: expected 3 values, found 2'),
    ({'tool_push_start': [1.0]}, 'tool_push_duration: expected 1 value, found 0'),
    ({'tool_push_start': [-1.0], 'tool_push_duration': [1.0],
      'tool_push_force_world': [1.0, 2.0, 3.0]}, 'tool_push_start: expected no negative value'),
    ({'sensor': {'mounting': [1.0]}}, 'sensor.mounting: expected 9 values or none, found 1'),
    ({'actuator_delay_ticks': 6}, 'actuator_delay_ticks: expected'),
    ({'substep': 0.0}, 'substep: expected greater than 0'),
    ({'drives': 'soft'}, "drives: expected 'rigid' or 'flexible'"),
    ({'sensor': {'bias': [0.0]}}, 'sensor.bias: expected 6 values, found 1'),
    ({'sensor': {'full_scale': [0.0] * 6}}, 'sensor.full_scale: expected values above 0'),
    ({'surfaces': {'table': {'stiffness': -1.0}}},
     'surfaces.table.stiffness: expected greater than 0'),
    ({'surfaces': {'table': {'normal_world': [0.0, 0.0, -1.1]}}},
     'surfaces.table.normal_world: expected a vector of unit length'),
    ({'surfaces': {'table': {'stifness': 1.0}}}, "unknown key 'stifness'"),
    ({'surfaces': {'table': {'mass': 0.01}}},
     'surfaces.table.mass: expected 0 or at least 0.033 kg'),
    ({'surfaces': {'table': {'mass': 1.0, 'velocity': 0.1}}},
     'surfaces.table.velocity: expected 0 of a body that gives way'),
    ({'surfaces': {'table': {'opposed_by': 'right'}}},
     'surfaces.table.mass: expected above 0 kg of a body that is pressed from behind'),
    ({'surfaces': {'table': {'mass': 1.0, 'opposed_by': '1st'}}},
     'expected names of letters, digits and _, joined by /'),
    ({'contact_names': ['edge', 'board'],
      'surfaces': {'table': {'mass': 1.0, 'opposed_by': 'right', 'contact': 'edge'}}},
     'surfaces.table.opposed_by: expected none for an obstacle, or a tip of an edge'),
    ({'contact_names': ['table'], 'obstacle_names': ['board'],
      'surfaces': {'board': {'mass': 1.0, 'opposed_by': 'right'}}},
     'surfaces.board.opposed_by: expected none for an obstacle'),
    ({'home': [0.0, 0.0, 'nan', 0.0, 0.0, 0.0]}, 'home.2: expected a finite number'),
])
def test_config_names_the_bad_field(change, message):
    with pytest.raises(ConfigError) as caught:
        changed(change)
    assert message in str(caught.value)


def test_rigid_drives_need_no_springs():
    assert changed({'drives': 'rigid', 'drive_stiffness': [], 'drive_damping': []}).drives


@pytest.mark.parametrize(('rate', 'expected'), [(500.0, 8), (1000.0, 4), (4000.0, 1)])
def test_substeps_fill_the_period(rate, expected):
    assert plant_config('puma').substeps(rate) == expected


@pytest.mark.parametrize('rate', [300.0, 8000.0])
def test_substep_that_does_not_divide_the_period_is_refused(rate):
    with pytest.raises(ConfigError, match='substep: expected a whole fraction'):
        plant_config('puma').substeps(rate)
