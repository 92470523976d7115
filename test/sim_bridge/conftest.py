"""What the tests of the plant share."""

from arms import plant_config
from multicontact_control.config import merge
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
    """Build plants of the PUMA from a preset with nested changes, and close them afterwards."""
    plants = []

    def make(preset='rigid', *, seed=0, rate=500.0, surfaces=None, **changes):
        both = {'surfaces': dict.fromkeys(('table', 'board'), surfaces or {})}
        config = plant_config(preset, **merge(both, changes))
        plant = Plant(config, rate=rate, seed=seed)
        plants.append(plant)
        return plant

    yield make
    for plant in plants:
        plant.close()
