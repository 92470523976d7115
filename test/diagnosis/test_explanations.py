"""Causes that the readings can tell, on simulated arms; others are not guessed."""

from collections import deque

from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from robots import robot_parameters
from scipy.spatial.transform import Rotation

WEIGHS = 'weigh as if gravity were'
LATE = 'the wrench reads what the torques have shown about'
AXES = 'the wrench sensor reads'
EXCHANGED = {
    'x and y': ([1, 0, 2], [1.0, 1.0, 1.0]),
    'x and z': ([2, 1, 0], [1.0, 1.0, 1.0]),
    'z turned round': ([0, 1, 2], [1.0, 1.0, -1.0]),
}


def findings(robot, ticks=600, push=None, **plant):
    """Return what is found on an arm that has begun to be controlled."""
    loop = ClosedLoop(
        resolve('quick', robot=robot, plant='rigid', plant_overrides=plant),
        commanded=True,
    )
    found = []
    if push is not None:
        loop.plant.push(np.array(push), 1.0)
    for _ in range(ticks):
        loop.advance()
        found += loop.control.supervisor.findings
    loop.close()
    return found


@pytest.mark.parametrize(
    ('robot', 'degrees', 'axis'),
    [
        ('puma', 10.0, 'y'),
        ('ur5', 10.0, 'x'),
        ('panda', 10.0, 'x'),
        ('panda', 20.0, 'y'),
    ],
)
def test_base_that_is_tilted_is_told_by_what_arm_and_tool_weigh(robot, degrees, axis):
    turn = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)['xyz'.index(axis)])
    found = findings(robot, gravity_world=turn.apply([0.0, 0.0, -9.81]).tolist())
    line = next(text for text in found if WEIGHS in text)
    true = [float(x) for x in line.partition('[')[2].partition(']')[0].split(',')]
    np.testing.assert_allclose(true, turn.apply([0.0, 0.0, -9.81]), atol=0.35)
    assert float(line.partition('m/s^2, ')[2].split()[0]) == pytest.approx(
        degrees, abs=1.5
    )


@pytest.mark.parametrize('robot', ['puma', 'ur5'])
@pytest.mark.parametrize(
    'push', [[40.0, 0.0, 0.0], [0.0, 40.0, 0.0], [20.0, 20.0, -20.0]]
)
def test_push_from_the_first_sample_on_is_not_taken_for_gravity(robot, push):
    found = findings(robot, push=push)
    assert found and not any(WEIGHS in text for text in found)


def found_with(robot, corrupt, **options):
    """Return what is found while `quick` runs with another wrench."""
    loop = ClosedLoop(resolve('quick', robot=robot, plant='rigid', **options))
    found = []
    for _ in range(loop.setup.ticks):
        loop.advance(corrupt)
        found += [
            text for text in loop.control.supervisor.findings if text not in found
        ]
    loop.close()
    return found


def late(ticks):
    """Return what makes every wrench late, under right stamps."""
    past = deque(maxlen=ticks + 1)

    def corrupt(inputs):
        past.append(inputs.wrench.wrench.copy())
        return inputs._replace(wrench=inputs.wrench._replace(wrench=past[0]))

    return corrupt


def exchanged(order, signs):
    """Return what gives the sensor other axes."""

    def corrupt(inputs):
        wrench = inputs.wrench.wrench.reshape(2, 3)[:, order] * signs
        return inputs._replace(wrench=inputs.wrench._replace(wrench=wrench.ravel()))

    return corrupt


@pytest.mark.slow
@pytest.mark.parametrize('robot', robot_parameters(['puma', 'panda', 'ur5']))
def test_wrench_that_comes_late_is_told_by_the_collisions_that_pass(robot):
    found = found_with(robot, late(20))
    lags = [float(text.removeprefix(LATE).split()[0]) for text in found if LATE in text]
    assert lags and 25.0 <= min(lags) <= max(lags) <= 50.0
    assert not any(AXES in text for text in found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('robot', 'axes', 'said'),
    [
        ('puma', 'x and y', 'its x is y'),
        ('ur5', 'x and y', 'its x is y'),
        ('puma', 'x and z', 'its x is z'),
        ('puma', 'z turned round', 'its z is -z'),
    ],
)
def test_axes_of_the_sensor_that_are_exchanged_are_told_by_the_torques(
    robot, axes, said
):
    found = found_with(robot, exchanged(*EXCHANGED[axes]))
    told = [text for text in found if AXES in text]
    assert told and all(said in text for text in told)


@pytest.mark.slow
@pytest.mark.parametrize('robot', robot_parameters(['puma', 'panda']))
def test_touch_that_passes_is_no_late_wrench_and_no_other_axes(robot):
    loop = ClosedLoop(resolve('quick', robot=robot, plant='rigid'), commanded=True)
    found = []
    for tick in range(2000):
        if tick in (300, 900):
            loop.plant.push(np.array([0.0, 60.0, 20.0]), 0.05 * (1 + tick // 600))
        loop.advance()
        found += loop.control.supervisor.findings
    loop.close()
    assert not any(LATE in text or AXES in text for text in found)


def test_nothing_is_felt_before_the_first_sample_nor_after_a_reset():
    loop = ClosedLoop(resolve('quick', plant='rigid'), commanded=True)
    supervisor = loop.control.supervisor
    assert supervisor.explanations.stray_force() == ''
    for _ in range(50):
        loop.advance()
    supervisor.controller.controls['wrench'][0, 0] += 10.0
    assert 'N m while no contact is commanded' in supervisor.explanations.stray_force()
    supervisor.reset()
    assert supervisor.explanations.stray_force() == ''
    loop.close()
