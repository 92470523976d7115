"""What the tests of the plant share."""

from arms import plant_config
import numpy as np
import pytest
from sim_bridge.plant import Plant
from sim_bridge.robots import find_robot


@pytest.fixture(scope='session')
def puma():
    return find_robot('puma').arm


@pytest.fixture
def model(puma):
    """Return the arm with its tool, without armature."""
    return puma.model()


@pytest.fixture
def rng():
    return np.random.default_rng(20040426)


@pytest.fixture
def make_plant():
    """Build plants from a preset with nested changes, and close them afterwards."""
    plants = []

    def make(preset='rigid', *, seed=0, surfaces=None, sensor=None, **changes):
        config = plant_config(preset)
        if surfaces is not None:
            changes['surfaces'] = {
                name: surface.model_copy(update=surfaces)
                for name, surface in config.surfaces.items()}
        if sensor is not None:
            changes['sensor'] = config.sensor.model_copy(update=sensor)
        plants.append(Plant(config.model_copy(update=changes), rate=500.0, seed=seed))
        return plants[-1]

    yield make
    for plant in plants:
        plant.close()
