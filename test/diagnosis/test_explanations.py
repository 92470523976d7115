"""Causes that the readings can tell, on simulated arms; others are not guessed."""

from collections import deque
from contextlib import closing
import re

from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from robots import robot_parameters
from scipy.spatial.transform import Rotation
from supervision.test_recovery import quick_loop, with_wrench

WEIGHS = 'weigh as if gravity were'
LATE = 'the wrench reads what the torques have shown about'
AXES = 'the wrench sensor reads'
EXCHANGED = {
    'x and y': ([1, 0, 2], [1.0, 1.0, 1.0]),
    'x and z': ([2, 1, 0], [1.0, 1.0, 1.0]),
    'z turned round': ([0, 1, 2], [1.0, 1.0, -1.0]),
}


def findings_of(robot, ticks=600, pushes=(), **plant):
    """Return what is found on a commanded arm, pushed from ticks on: force [N], duration [s]."""
    setup = resolve('quick', robot=robot, plant='rigid', plant_overrides=plant)
    found = []
    with closing(ClosedLoop(setup, commanded=True)) as loop:
        for tick in range(ticks):
            for begin, force, duration in pushes:
                if tick == begin:
                    loop.plant.push(np.array(force), duration)
            loop.advance()
            found += loop.control.supervisor.findings
    return found


def holds(found, part):
    """Return whether a text is in any of what is found."""
    return any(part in text for text in found)


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
    turn = Rotation.from_euler(axis, degrees, degrees=True)
    gravity = turn.apply([0.0, 0.0, -9.81])
    found = findings_of(robot, gravity_world=gravity.tolist())
    line = next(text for text in found if WEIGHS in text)
    told, angle = re.search(r'\[(.*)\] m/s\^2, (\S+)', line).groups()
    np.testing.assert_allclose(np.fromstring(told, sep=','), gravity, atol=0.35)
    assert float(angle) == pytest.approx(degrees, abs=1.5)


@pytest.mark.parametrize('robot', ['puma', 'ur5'])
@pytest.mark.parametrize(
    'push', [[40.0, 0.0, 0.0], [0.0, 40.0, 0.0], [20.0, 20.0, -20.0]]
)
def test_push_from_the_first_sample_on_is_not_taken_for_gravity(robot, push):
    found = findings_of(robot, pushes=[(0, push, 1.0)])
    assert found
    assert not holds(found, WEIGHS)


def found_with(robot, corrupt, **options):
    """Return what is found while `quick` runs with another wrench."""
    setup = resolve('quick', robot=robot, plant='rigid', **options)
    found = set()
    with closing(ClosedLoop(setup)) as loop:
        for _ in range(setup.ticks):
            loop.advance(corrupt)
            found.update(loop.control.supervisor.findings)
    return found


def late(ticks):
    """Return what makes every wrench late, under right stamps."""
    past = deque(maxlen=ticks + 1)

    def change(wrench):
        past.append(wrench.copy())
        return past[0]

    return with_wrench(change)


def exchanged(order, signs):
    """Return what gives the sensor other axes."""

    def change(wrench):
        axes = wrench.reshape(2, 3)[:, order] * signs
        return axes.ravel()

    return with_wrench(change)


@pytest.mark.slow
@pytest.mark.parametrize('robot', robot_parameters(['puma', 'panda', 'ur5']))
def test_wrench_that_comes_late_is_told_by_the_collisions_that_pass(robot):
    found = found_with(robot, late(20))
    lags = [float(lag) for lag in re.findall(rf'{LATE} (\S+)', ' '.join(found))]
    assert lags
    assert min(lags) >= 25.0
    assert max(lags) <= 50.0
    assert not holds(found, AXES)


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
    assert told
    for text in told:
        assert said in text


@pytest.mark.slow
@pytest.mark.parametrize('robot', robot_parameters(['puma', 'panda']))
def test_touch_that_passes_is_no_late_wrench_and_no_other_axes(robot):
    force = [0.0, 60.0, 20.0]
    found = findings_of(robot, 2000, pushes=[(300, force, 0.05), (900, force, 0.1)])
    assert not holds(found, LATE)
    assert not holds(found, AXES)


def test_nothing_is_felt_before_the_first_sample_nor_after_a_reset():
    with closing(quick_loop('rigid')) as loop:
        supervisor = loop.control.supervisor
        explanations = supervisor.explanations
        assert explanations.stray_force() == ''
        for _ in range(50):
            loop.advance()
        supervisor.controller.controls['wrench'][0, 0] += 10.0
        assert 'while no contact is commanded' in explanations.stray_force()
        supervisor.reset()
        assert supervisor.explanations.stray_force() == ''
