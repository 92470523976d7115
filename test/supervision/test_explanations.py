"""Causes that the readings can tell, on simulated arms; others are not guessed."""

from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
from multicontact_control.supervision.report import CAPACITY, EventLog, SupervisorStatus
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

WEIGHS = 'weigh as if gravity were'


def findings(robot, ticks=600, push=None, **plant):
    """Return what is found on an arm that has begun to be controlled."""
    loop = ClosedLoop(resolve('quick', robot=robot, plant='rigid', plant_overrides=plant),
                      commanded=True)
    found = []
    if push is not None:
        loop.plant.push(np.array(push), 1.0)
    for _ in range(ticks):
        loop.advance()
        found += loop.control.supervisor.findings
    loop.close()
    return found


@pytest.mark.parametrize(('robot', 'degrees', 'axis'), [
    ('puma', 10.0, 'y'), ('ur5', 10.0, 'x'), ('panda', 10.0, 'x'), ('panda', 20.0, 'y')])
def test_base_that_is_tilted_is_told_by_what_arm_and_tool_weigh(robot, degrees, axis):
    turn = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)['xyz'.index(axis)])
    found = findings(robot, gravity_world=turn.apply([0.0, 0.0, -9.81]).tolist())
    line = next(text for text in found if WEIGHS in text)
    true = [float(x) for x in line.partition('[')[2].partition(']')[0].split(',')]
    np.testing.assert_allclose(true, turn.apply([0.0, 0.0, -9.81]), atol=0.35)
    assert float(line.partition('m/s^2, ')[2].split()[0]) == pytest.approx(degrees, abs=1.5)


@pytest.mark.parametrize('robot', ['puma', 'ur5'])
@pytest.mark.parametrize('push', [[40.0, 0.0, 0.0], [0.0, 40.0, 0.0], [20.0, 20.0, -20.0]])
def test_push_from_the_first_sample_on_is_not_taken_for_gravity(robot, push):
    found = findings(robot, push=push)
    assert found and not any(WEIGHS in text for text in found)


def test_log_keeps_what_came_last():
    """The cause of the end, and not the beginning of a long run."""
    log = EventLog()
    for k in range(CAPACITY + 5):
        log.note(0.002 * k, SupervisorStatus('none', (f'cause_{k}',), (), (), (), 0.0))
    assert len(log.events) == CAPACITY
    assert log.events[0] == (pytest.approx(0.01), 'none | cause_5 | ')
    assert f'cause_{CAPACITY + 4}' in log.events[-1][1]
    assert log.reactions['none'] == CAPACITY + 5
