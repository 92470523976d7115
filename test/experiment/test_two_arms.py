"""Two arms that press one board from both sides, each with its loop and its own copy of it."""

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
import numpy as np
import pytest

BOARD = 1
DELAY = 2  # periods, after which an arm hears how the other presses


def press(count, duration):
    """Return the setup, and true forces and places of the board of so many arms, by sample."""
    loops = [ClosedLoop(resolve(
        'two_arms', plant='puma', seed=seed, scenario_overrides={'duration': duration}))
        for seed in range(51, 51 + count)]
    setup = loops[0].setup
    forces = np.zeros((count, setup.ticks, 2))
    places = np.zeros((count, setup.ticks))
    for k in range(setup.ticks):
        for i, loop in enumerate(loops):
            contacts = loop.plant.contacts
            forces[i, k] = loop.true_forces
            places[i, k] = contacts.places_world[BOARD] @ setup.plant.surfaces[
                'board'].normal_world
            if count == 2 and k >= DELAY:
                contacts.oppose(BOARD, forces[1 - i, k - DELAY, BOARD])
            loop.advance()
    for loop in loops:
        loop.close()
    return setup, forces, places - places[:, :1]


@pytest.mark.slow
def test_two_arms_squeeze_a_board_that_one_pushes_away():
    setup, alone, pushed_by = press(1, 6.5)
    _, forces, places = press(2, 9.0)
    rest = slice(round(5.5 * 500), round(6.5 * 500))
    assert np.sqrt(((alone[0, rest] - 15.0) ** 2).mean(axis=0)).max() < 0.1
    stiffness = setup.plant.surfaces['board'].mount_stiffness
    assert pushed_by[0, rest].mean() == pytest.approx(15.0 / stiffness, rel=0.02)
    for own in forces:
        assert np.sqrt(((own[rest] - 15.0) ** 2).mean(axis=0)).max() < 0.1
        moving = own[round(7.5 * 500):]
        assert np.sqrt(((moving - 15.0) ** 2).mean(axis=0)).max() < 1.0
        assert (own[round(2.0 * 500):] > 0.0).all()
    # In the middle, up to what 0.1 N does, and the same board on both sides but for the delay.
    assert np.abs(places[:, rest]).max() < 0.1 / stiffness
    assert np.abs(places.sum(axis=0)).max() < 1e-3


def test_another_graph_is_not_heard_in_process():
    setup = resolve('two_arms', plant_overrides={'surfaces': {'board': {'opposed_by': 'right'}}})
    with pytest.raises(ConfigError, match=r'^plant\.surfaces\.board\.opposed_by: expected none'):
        ClosedLoop(setup)
