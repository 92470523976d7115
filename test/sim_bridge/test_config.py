from arms import plant_config
from multicontact_control.errors import ConfigError
import pytest


@pytest.mark.parametrize(('change', 'field'), [
    ({'contact_names': ['table', 'wall']}, 'contact_names'),
    ({'contact_names': ['table', 'table']}, 'contact_names'),
    ({'drive_stiffness': [1.0, 2.0]}, 'drive_stiffness'),
    ({'drive_stiffness': [0.0] * 6}, 'drive_stiffness'),
    ({'push_start': [1.0]}, 'push_duration'),
    ({'sensor': {'mounting': [1.0]}}, 'sensor.mounting'),
    ({'surfaces': {'table': {'normal_world': [0.0, 0.0, -1.1]}}}, 'surfaces.table.normal_world'),
    ({'surfaces': {'table': {'stifness': 1.0}}}, 'surfaces.table.stifness'),
    ({'surfaces': {'table': {'shape': 'sphere'}}}, 'surfaces.table.radius'),
    ({'home': [0.0, 0.0, 'nan', 0.0, 0.0, 0.0]}, 'home.2'),
    ({'contact': 'native'}, 'contact'),
    ({'contact': 'native', 'engine': 'mujoco', 'surfaces': {
        'table': {'shape': 'sphere', 'radius': 1.0}}}, 'surfaces.table')])
def test_config_names_the_bad_field(change, field):
    with pytest.raises(ConfigError) as caught:
        plant_config('puma', **change)
    assert field in {error.field for error in caught.value.errors}
